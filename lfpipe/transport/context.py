"""The stage API: its input at its start, configuration, rings, status row, and the only blocking
call.

A stage's ends of rings wake readers, and count missed slots. In lossless sessions, a reader reports
in its status row how far it has read a ring, and the writer waits for it.
"""

import contextlib
import gc
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import attrs
import zmq
from numpy.typing import NDArray

from lfpipe.config import Config, SessionOptions, Snapshot, converter
from lfpipe.config.session_options import Lossless
from lfpipe.errors import UserError
from lfpipe.host.files import Wake, readable
from lfpipe.host.worker import usable_cores
from lfpipe.transport import control, ring, status
from lfpipe.transport.control import Answer, Session
from lfpipe.transport.ring import MS_NS, now_ns
from lfpipe.transport.status import ENDED, NO_METRICS, MetricSet, State


@attrs.frozen(kw_only=True)
class Stage:
    """A row of the process table, also for the entry points of the group `lfpipe.stages`."""

    name: str
    module: str
    """Contains `main(context)`."""
    needed: Callable[[SessionOptions], bool]
    """Whether a session with these options runs it."""
    reads: tuple[str, ...] = ()
    """Rings."""
    writes: tuple[str, ...] = ()
    """Rings."""
    asks_for: Callable[[SessionOptions], tuple[str, ...]] = lambda _: ()
    """The on-demand rings that it reads and needs with these options."""
    metrics: MetricSet = NO_METRICS
    """Declared in its own package."""
    optional: bool = False
    """Whether few sessions run it, and no picture waits for it."""
    restart_on_viewer_change: bool = False
    """Whether it starts again for another viewer."""
    own_core: bool = False
    """Whether it avoids the first of two cores."""


@attrs.frozen(kw_only=True)
class StageSpec:
    """Everything that a stage's process receives at its start."""

    name: str
    module: str
    """Contains `main(context)`."""
    session: Session
    config: Config
    rev: int
    """Of the session's state."""
    options: SessionOptions
    consumers: dict[str, list[str]]
    """Ring -> stages that read it."""
    others: tuple[str, ...]
    """The other stages of the session."""
    source: str
    """The stage that makes frames."""
    cpus: tuple[int, ...] = ()
    """Cores to run on; empty: all."""
    request: int = 0
    """The number of the request that it answers once it can do its work; 0: of none."""

    def ring_index(self, name: str) -> int:
        """The index of a ring's credit in a status row."""
        return list(self.consumers).index(name)


class RingInput:
    """The reading end of a ring with its wake-up. row: the stage's own status row."""

    def __init__(self, spec: StageSpec, name: str, row: status.Row) -> None:
        session = spec.session
        clock = spec.options.clock
        self._row = row
        self.reader = ring.Reader(session.segment(name))
        self.wake = Wake(session.wake(name, spec.name))
        self._credit = (
            Wake(session.credit(name, spec.name)) if isinstance(clock, Lossless) else None
        )
        self._lock_step = isinstance(clock, Lossless) and clock.lock_step
        self._index = spec.ring_index(name)
        self._read_seq = row.record["taken_seq"].data
        seq = int(self._read_seq[self._index])
        if self._credit or seq:  # a predecessor died: count its unread slots, and later ones
            self.reader.last_seq = min(self.reader.last_seq, seq)

    def take(self, out: NDArray[Any], in_order: bool = False) -> ring.Stamp | None:
        """Copies the newest slot to out, if there is a new one; on request or in lossless sessions,
        the next in order. Skipped slots count as drops.
        """
        self.wake.drain()
        stamp = self.reader.read_next(out) if in_order or self._credit else self.reader.read(out)
        if stamp is not None:
            self._on_read(stamp)
        return stamp

    def peek(self, in_order: bool = False) -> tuple[ring.Stamp, NDArray[Any]] | None:
        """Like `take`, but returns the slot itself, read-only. Results made from it are valid only
        if `still_valid` confirms it.
        """
        self.wake.drain()
        peeked = self.reader.peek(in_order or self._credit is not None)
        if peeked is not None:
            self._on_read(peeked[0])
        return peeked

    def still_valid(self, stamp: ring.Stamp) -> bool:
        """Whether the writer has not touched a peeked slot; if it has, the slot counts as a
        drop.
        """
        valid = self.reader.still_valid(stamp)
        self._row["drops"] += not valid
        return valid

    def _on_read(self, stamp: ring.Stamp) -> None:
        if self._credit and self.reader.published > stamp.seq:
            # another slot is waiting, but its wake-up has just been consumed
            self.wake.notify(stamp.seq)
        self._row["drops"] += stamp.skipped
        if self._credit is None:
            self._read_seq[self._index] = stamp.seq - 1  # they have already been counted
        elif not self._lock_step:
            self.give_credit()

    def done(self) -> None:
        """Reports that everything taken has been processed.

        If this process dies, its successor counts later slots as dropped.
        """
        if self._credit is None:
            self._read_seq[self._index] = self.reader.last_seq

    def wait(self) -> None:
        """Reports that the stage waits: in lock-step, everything taken has been processed."""
        if self._lock_step:
            self.give_credit()

    def give_credit(self) -> None:
        """Reports to the writer that the slots taken so far may be overwritten; in lock-step, that
        they have been processed.
        """
        if self._credit is not None and self._read_seq[self._index] != self.reader.last_seq:
            self._read_seq[self._index] = self.reader.last_seq
            self._credit.notify(self.reader.last_seq)


class RingOutput:
    """The writing end of a ring with the wake-ups of its readers.

    table: the status table. wait_for: waits until a condition holds, woken by credits. done:
    reports that the stage has processed what it took.
    """

    def __init__(
        self,
        spec: StageSpec,
        name: str,
        table: status.Table,
        wait_for: Callable[[Callable[[], bool], Sequence[Wake]], None],
        done: Callable[[], None],
    ) -> None:
        session = spec.session
        clock = spec.options.clock
        self._wait_for = wait_for
        self._done = done
        self._index = spec.ring_index(name)
        self.writer = ring.Writer(session.segment(name))
        readers = spec.consumers.get(name, [])
        # with the state of each reader: one that does not run leaves its FIFO full
        self._wakes = [
            (Wake(session.wake(name, reader)), table.rows[reader]["state"].reshape(1).data)
            for reader in readers
        ]
        self._lock_step = isinstance(clock, Lossless) and clock.lock_step
        # number of slots that readers may be behind
        self._ahead = 0 if self._lock_step else max(0, self.writer.slots - 4)
        waits_for = readers if isinstance(clock, Lossless) else []
        self._rows = [table.rows[reader] for reader in waits_for]
        self.credits = [Wake(session.credit(name, reader)) for reader in waits_for]

    def begin(self) -> NDArray[Any]:
        """The slot to fill, in place."""
        return self.writer.begin()

    def publish(
        self,
        source_seq: int,
        t_sensor_ns: int,
        t_read_ns: int,
        epoch: int | None = None,
        kind: int = 0,
    ) -> int:
        """Publishes the slot of `begin` and wakes the readers. In lossless sessions, it first waits
        until they are at most a few slots behind. In lock-step, it then waits until they have
        processed this one.
        """
        if self._rows:
            self._wait_for(self._all_read, self.credits)
        seq = self.writer.publish(source_seq, t_sensor_ns, t_read_ns, epoch, kind)
        # at once: if the process is killed before this line, the new slot counts as lost
        self._done()
        for wake, state in self._wakes:
            if state[0] not in ENDED:
                wake.notify(seq)
        if self._lock_step:
            self._wait_for(self._all_read, self.credits)
        return seq

    def _all_read(self) -> bool:
        for credit in self.credits:
            credit.drain()
        seq = self.writer.published - self._ahead
        return all(
            int(row["taken_seq"][self._index]) >= seq or int(row["state"]) in ENDED
            for row in self._rows
        )

    def close(self) -> None:
        """Ends writing: another stage may write the ring from now on."""
        self.writer.close()
        for wake in (*self.credits, *(one for one, _ in self._wakes)):
            wake.close()


logger = logging.getLogger(__name__)
# longest wait of a stage without a heartbeat, and that while there is little to do
BEAT_NS, IDLE_BEAT_NS = 100 * MS_NS, 500 * MS_NS


class Context:
    """Everything a stage needs.

    A stage sleeps only in `wait`, which sends heartbeats, receives commands and detects the stop.
    """

    def __init__(self, spec: StageSpec) -> None:
        self.spec = spec
        self.config = spec.config
        self.table = status.Table(spec.session.segment("status"), writable=True)
        self.row = status.Row(self.table.rows[spec.name], self.table.metrics[spec.name])
        self.options = spec.options
        self.stopping = False
        self.paused = False
        self.cores = usable_cores()  # of the session, before the stage moves to its own core
        # whether a message arrived since the last call of `commands`
        self.news = True
        self._inputs: list[RingInput] = []
        # kept until the end: memory maps must outlive their views
        self._open: list[RingInput | RingOutput] = []
        self._commands: list[tuple[str, control.Message]] = []
        self._answers: list[Answer] = []
        self._zmq = control.context()
        self._ctl = self._zmq.socket(zmq.DEALER)
        self._ctl.setsockopt(zmq.IDENTITY, spec.name.encode())
        control.connect(self._ctl, spec.session.run_dir, "ctl")
        self._bus = self._zmq.socket(zmq.PUSH)
        self._bus.setsockopt(zmq.SNDHWM, 16)
        control.connect(self._bus, spec.session.run_dir, "bus")
        self._ctl.send(control.encode({"cmd": "hello", "stage": spec.name}))
        self._rev = spec.rev
        self._converter = converter()  # its import takes longer than a stage may block
        self._ctl_fd = int(self._ctl.getsockopt(zmq.FD))
        self._must_poll = True
        self._fds = [self._ctl_fd]

    def input(self, name: str) -> RingInput:
        """Opens a ring for reading; `wait` then wakes for it."""
        ring_input = RingInput(self.spec, name, self.row)
        self._inputs.append(ring_input)
        self._open.append(ring_input)
        self._fds.append(ring_input.wake.fd)
        return ring_input

    def output(self, name: str) -> RingOutput:
        """Opens a ring for writing; each ring has one writing stage."""
        ring_output = RingOutput(self.spec, name, self.table, self._wait_for, self.done)
        self._open.append(ring_output)
        return ring_output

    def ready(self) -> None:
        """Ends the setup: from now on, a missing heartbeat means a hang. Freezes the current
        objects so that the garbage collector skips them (gc.freeze).
        """
        gc.freeze()
        self.row["epoch"] += 1
        self.row.heartbeat()  # first: a stage delayed between these lines is not hung
        self.row["ready_ns"] = now_ns()
        self.row["state"] = State.RUNNING
        logger.info("ready after %.2f s", (now_ns() - int(self.row["started_ns"])) / 1e9)

    @contextlib.contextmanager
    def busy_with(self, work: str) -> Iterator[None]:
        """Wraps calls that may wait for a disk: the stage then hangs only after a longer time.

        work: a description for monitors, at most 32 bytes. See `StageProcess.hang_reason`.
        """
        self.row.set_busy(work)
        try:
            yield
        finally:
            self.row.set_busy("")

    @contextlib.contextmanager
    def setting_up(self, work: str) -> Iterator[None]:
        """Like `busy_with`, for work that may also compute for long: the limits are those of a
        start.
        """
        before = self.row["state"]
        self.row["state"] = State.STARTING
        try:
            with self.busy_with(work):
                yield
        finally:
            self.row["state"] = before

    @contextlib.contextmanager
    def saving(self, work: str) -> Iterator[None]:
        """Like `busy_with`, for writing results at the end: the end of the session waits for it."""
        self.row["state"] = State.STOPPING
        with self.busy_with(work):
            yield

    def wait_for_others(self) -> bool:
        """Waits until every other stage is ready, so that no frame of a recording is lost. Returns
        False once the stage must end.
        """
        while not all(int(self.table.rows[name]["ready_ns"]) for name in self.spec.others):
            if not self.wait(now_ns() + 5 * MS_NS):
                return False
        return True

    def emit(self, topic: str, **values: Any) -> None:
        """Sends telemetry to the subscribers of the tap; without a subscriber it is lost."""
        message = {"topic": topic, "stage": self.spec.name, "t_ns": now_ns(), **values}
        with contextlib.suppress(zmq.Again):
            self._bus.send(control.encode(message), zmq.NOBLOCK)

    def notify(self, text: str) -> None:
        """Notifies the user."""
        self.emit("notice", text=text)

    def report_lost(self, why: str) -> None:
        """Reports that a file of the session ended early or was not written; the session's exit
        code is then not 0.
        """
        self.row["lost_outputs"] += 1
        self.notify(why)

    def request(self, word: str, **values: Any) -> None:
        """Sends the supervisor a command, as `lfpipe ctl` would; its answer appears in
        `answers`.
        """
        self._ctl.send(control.encode({"cmd": word, **values}))
        self._must_poll = True

    def answer(
        self, command: control.Message, refusal: UserError | None = None, **result: Any
    ) -> None:
        """Answers a command of `commands` once it is executed: its client receives the result, or
        the refusal.
        """
        if refusal is not None:
            result = {"error": refusal.message, "remedy": refusal.remedy}
        self.request(
            control.EXECUTED, number=command.get("number", 0), ok=refusal is None, **result
        )

    def ack_config(self) -> None:
        """Acknowledges the current `config`, `options` and `paused`."""
        self.row["config_rev"] = self._rev

    def commands(self) -> list[tuple[str, control.Message]]:
        """Commands since the last call, as (command, message). A change of configuration is already
        in `config`.
        """
        self.news = False
        commands, self._commands = self._commands, []
        return commands

    def answers(self) -> list[Answer]:
        """Answers since the last call, to a `request`."""
        answers, self._answers = self._answers, []
        return answers

    @property
    def idle(self) -> bool:
        """Whether there is little to do: the session is paused, or nobody looks."""
        return self.paused or self.options.idle

    def wait(
        self, until_ns: int | None = None, inputs: bool = True, fds: Sequence[int] = ()
    ) -> bool:
        """Sleeps until an input has a new slot, a command or the stop arrives, one of fds can be
        read, or until_ns; at most BEAT_NS, while idle IDLE_BEAT_NS.

        Returns False once the stage must end. inputs: False if it cannot use their data now.
        """
        self.row.heartbeat()
        self.done()  # a waiting stage has processed its inputs
        for ring_input in self._inputs:
            ring_input.wait()
        t_ns = now_ns()
        limit_ns = t_ns + (IDLE_BEAT_NS if self.idle else BEAT_NS)
        until_ns = limit_ns if until_ns is None else min(until_ns, limit_ns)
        descriptors = self._fds if inputs else [self._ctl_fd]
        self._sleep([*descriptors, *fds], max(until_ns - t_ns, 0))
        return not self.stopping

    def _sleep(self, fds: Sequence[int], left_ns: int) -> None:
        """Sleeps until a descriptor is readable or left_ns have passed, and takes messages. The
        socket's own descriptor stays readable from an arrival until the socket is used: after a
        request, the socket itself must be asked.
        """
        ready = readable(fds, 0.0 if self._must_poll else left_ns / 1e9)
        if self._must_poll or self._ctl_fd in ready:
            self._must_poll = False
            self._receive_messages()

    def done(self) -> None:
        """Reports that everything taken from the inputs has been processed."""
        for ring_input in self._inputs:
            ring_input.done()

    def _wait_for(self, condition: Callable[[], bool], credits: Sequence[Wake]) -> None:
        """Waits until condition holds or the stop arrives; credits wake it."""
        fds = [self._ctl_fd, *(credit.fd for credit in credits)]
        while not condition() and not self.stopping:
            self.row.heartbeat()
            self._sleep(fds, BEAT_NS)

    def _receive_messages(self) -> None:
        while self._ctl.poll(0):
            self.news = True
            message = control.decode(self._ctl.recv())
            word = message.get("cmd", "")
            if "ok" in message and "config" not in message:
                self._answers.append(Answer.of(message))
            elif word == "stop":
                self.stopping = True
            elif word in ("config", "hello") and "config" in message:
                snapshot = self._converter.structure(message, Snapshot)
                self.config = snapshot.config
                self.options = snapshot.options
                self.paused = snapshot.paused
                self._rev = snapshot.rev
                logger.debug("has revision %d", self._rev)
            else:
                self._commands.append((word, message))

    def close(self) -> None:
        """Closes the sockets; the mappings end with the process."""
        self._ctl.close()
        self._bus.close(linger=200)  # final messages, with the reason for the end of an output
        self._zmq.term()
