"""The stage API: configuration, rings, status row, and the only blocking call."""

import contextlib
import gc
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import zmq

from lfpipe.config import Snapshot, converter
from lfpipe.errors import UserError
from lfpipe.host.processes import usable_cores
from lfpipe.host.wake import Wake, readable
from lfpipe.transport import control, status
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.control import Answer
from lfpipe.transport.ring_io import RingInput, RingOutput, StageSpec
from lfpipe.transport.status import State

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
        self._used = True
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
        self._used = True

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
        taken = self._commands
        self._commands = []
        return taken

    def answers(self) -> list[Answer]:
        """Answers since the last call, to a `request`."""
        taken = self._answers
        self._answers = []
        return taken

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
        own = self._fds if inputs else [self._ctl_fd]
        self._sleep([*own, *fds], max(until_ns - t_ns, 0))
        return not self.stopping

    def _sleep(self, fds: Sequence[int], left_ns: int) -> None:
        """Sleeps until a descriptor is readable or left_ns have passed, and takes messages. The
        socket's own descriptor stays readable from an arrival until the socket is used: after a
        request, the socket itself must be asked.
        """
        ready = readable(fds, 0.0 if self._used else left_ns / 1e9)
        if self._used or self._ctl_fd in ready:
            self._used = False
            self._take_messages()

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

    def _take_messages(self) -> None:
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
