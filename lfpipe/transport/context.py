"""What a stage is given: its configuration, its rings with their wakes, its status row, and one place to wait."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
import zmq
from numpy.typing import NDArray

from lfpipe import config as config_module
from lfpipe.config import Config
from lfpipe.transport import control, ring, status
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.session import Session
from lfpipe.transport.status import State
from lfpipe.transport.wake import Wake

BEAT_NS = 100 * MS_NS  # the longest a stage may wait without showing that it lives


@attrs.frozen
class StageSpec:
    """All that a stage's process is told at its start. Plain values, so that it can be sent to a spawned process.

    consumers: ring -> stages that read it. others: the other stages of the session. lossless: no slot may be lost, writers wait
    for readers (`pace=max`, replay). lock_step: besides, a frame has gone through every stage before the next one starts.
    cpus: cores to run on, none for all. nice: niceness, None for the supervisor's.
    """

    name: str
    module: str
    session: Session
    config: dict[str, Any]
    rev: int
    options: dict[str, Any]
    consumers: dict[str, list[str]]
    others: tuple[str, ...]
    lossless: bool
    lock_step: bool = False
    cpus: tuple[int, ...] = ()
    nice: int | None = None

    def ring_index(self, name: str) -> int:
        """Where a ring's credit lies in a status row."""
        return list(self.consumers).index(name)


class Input:
    """The reading end of a ring with its wake."""

    def __init__(self, context: Context, name: str) -> None:
        session, self._row = context.spec.session, context.row
        self.reader = ring.Reader(session.segment(name))
        self.wake = Wake(session.wake(name, context.spec.name))
        self._credit: Wake | None = None
        self._lock_step = context.spec.lock_step
        self._index = context.spec.ring_index(name)
        self._taken = self._row.record["taken_seq"].data
        taken = int(self._taken[self._index])
        if context.spec.lossless:
            self._credit = Wake(session.credit(name, context.spec.name))
        if context.spec.lossless or taken:  # a process before this one died: what it left and what came since counts
            self.reader.last_seq = min(self.reader.last_seq, taken)

    def take(self, out: NDArray[Any], in_order: bool = False) -> ring.Stamp | None:
        """The newest slot copied into out, when there is a new one; the next in order where that is asked for or nothing may
        be lost. Slots missed count as drops.
        """
        self.wake.drain()
        stamp = self.reader.read_next(out) if in_order or self._credit else self.reader.read(out)
        if stamp is not None:
            self._took(stamp)
        return stamp

    def lend(self, in_order: bool = False) -> tuple[ring.Stamp, NDArray[Any]] | None:
        """As `take`, but the slot itself, read-only; what is made of it counts only if it is still `whole` afterwards."""
        self.wake.drain()
        lent = self.reader.lend(in_order or self._credit is not None)
        if lent is not None:
            self._took(lent[0])
        return lent

    def whole(self, stamp: ring.Stamp) -> bool:
        """Whether a lent slot was left alone until now; if not, it counts as a drop."""
        left_alone = self.reader.whole(stamp)
        self._row["drops"] += not left_alone
        return left_alone

    def _took(self, stamp: ring.Stamp) -> None:
        if self._credit and self.reader.published > stamp.seq:
            self.wake.notify(stamp.seq)  # another one waits, and its wake has just been drained
        self._row["drops"] += stamp.skipped
        if self._credit is None:
            self._taken[self._index] = stamp.seq - 1  # those are counted
        elif not self._lock_step:
            self.give_credit()

    def skip(self) -> None:
        """What was published until now is none of this process's business."""
        self.reader.last_seq = self.reader.published
        self.give_credit()

    def done(self) -> None:
        """All that was taken is dealt with; what this process never deals with after it, its successor counts as dropped."""
        if self._credit is None:
            self._taken[self._index] = self.reader.last_seq

    def give_credit(self) -> None:
        """Tells the writer that what was taken so far needs no more room; in lock-step, that all is done with it."""
        if self._credit is not None and self._taken[self._index] != self.reader.last_seq:
            self._taken[self._index] = self.reader.last_seq
            self._credit.notify(self.reader.last_seq)


class Output:
    """The writing end of a ring with the wakes of its readers."""

    def __init__(self, context: Context, name: str) -> None:
        session, self._context = context.spec.session, context
        self._index = context.spec.ring_index(name)
        self.writer = ring.Writer(session.segment(name))
        self._ahead = 0 if context.spec.lock_step else max(0, self.writer.slots - 4)  # slots that readers need not have taken yet
        readers = context.spec.consumers.get(name, [])
        self._wakes = [Wake(session.wake(name, reader)) for reader in readers]
        self._rows = [context.table.rows[reader] for reader in readers] if context.spec.lossless else []
        self.credits = [Wake(session.credit(name, reader)) for reader in readers] if context.spec.lossless else []

    def begin(self) -> NDArray[Any]:
        """The slot to fill, in place."""
        return self.writer.begin()

    def publish(self, source_seq: int, t_sensor_ns: int, t_read_ns: int, epoch: int | None = None) -> int:
        """Publishes the slot of `begin`, wakes the readers. Where nothing may be lost, first waits until they are no more than
        a few slots behind; in lock-step, then until they are done with this one.
        """
        if self._rows:
            self._context.wait_for(self._all_taken, self.credits)
        seq = self.writer.publish(source_seq, t_sensor_ns, t_read_ns, epoch)
        self._context.done()  # at once: a kill before this line counts as lost what has just been published
        for wake in self._wakes:
            wake.notify(seq)
        if self._context.spec.lock_step:
            self._context.wait_for(self._all_taken, self.credits)
        return seq

    def _all_taken(self) -> bool:
        for credit in self.credits:
            credit.drain()
        wanted = self.writer.published - self._ahead
        gone = (State.NONE, State.DEAD)
        return all(int(row["taken_seq"][self._index]) >= wanted or int(row["state"]) in gone for row in self._rows)


class Context:
    """A stage's world. `wait` is the only place where a stage sleeps: it beats, takes commands and notices the stop."""

    def __init__(self, spec: StageSpec) -> None:
        self.spec = spec
        self.config: Config = config_module.trusted(spec.config)
        self.table = status.Table(spec.session.segment("status"), writable=True)
        self.row = status.Row(self.table.rows[spec.name])
        self.options: dict[str, Any] = spec.options
        self.stopping = False
        self.paused = False
        self._poller = zmq.Poller()
        self._inputs: list[Input] = []
        self._open: list[Input | Output] = []  # kept to the end: their mappings go with the process, not before their views
        self._commands: list[tuple[str, dict[str, Any]]] = []
        self._zmq = control.context()
        self._ctl = self._zmq.socket(zmq.DEALER)
        self._ctl.setsockopt(zmq.IDENTITY, spec.name.encode())
        self._ctl.connect(control.address(spec.session.run_dir, "ctl"))
        self._bus = self._zmq.socket(zmq.PUSH)
        self._bus.setsockopt(zmq.SNDHWM, 16)
        self._bus.connect(control.address(spec.session.run_dir, "bus"))
        self._poller.register(self._ctl, zmq.POLLIN)
        self._ctl.send(control.encode({"cmd": "hello", "stage": spec.name}))
        self._rev = spec.rev

    def input(self, name: str) -> Input:
        """Opens a ring for reading and makes `wait` wake for it."""
        made = Input(self, name)
        self._inputs.append(made)
        self._open.append(made)
        self._poller.register(made.wake.fd, zmq.POLLIN)
        return made

    def output(self, name: str) -> Output:
        """Opens a ring for writing; one stage a ring."""
        made = Output(self, name)
        self._open.append(made)
        for credit in made.credits:
            self._poller.register(credit.fd, zmq.POLLIN)
        return made

    def ready(self) -> None:
        """Set-up is over: from now on a missing beat means a hang."""
        self.row["epoch"] += 1
        self.row.beat()  # before it counts: who is held up between the two lines has not hung
        self.row["ready_ns"] = now_ns()
        self.row["state"] = State.RUNNING

    def wait_for_others(self) -> bool:
        """Waits until every other stage is ready, so that a recording begins when there is somebody to see it.

        Returns False once the stage must end.
        """
        while not all(int(self.table.rows[name]["ready_ns"]) for name in self.spec.others):
            if not self.wait(now_ns() + 5 * MS_NS):
                return False
        return True

    def emit(self, topic: str, **values: Any) -> None:
        """Telemetry for whoever listens on the tap; lost when nobody takes it."""
        try:
            self._bus.send(control.encode({"topic": topic, "stage": self.spec.name, "t_ns": now_ns(), **values}), zmq.NOBLOCK)
        except zmq.Again:
            return

    def request(self, word: str, **values: Any) -> None:
        """Sends the supervisor a command, as `lfpipe ctl` would; the answer is not waited for."""
        self._ctl.send(control.encode({"cmd": word, **values}))

    def applied(self) -> None:
        """The stage works by `config`, `options` and `paused` as they are now; the supervisor may tell who asked."""
        self.row["config_rev"] = self._rev

    def commands(self) -> list[tuple[str, dict[str, Any]]]:
        """What arrived since the last call: (word, message). A change of configuration is already in `config`."""
        taken, self._commands = self._commands, []
        return taken

    def wait(self, until_ns: int | None = None) -> bool:
        """Sleeps until an input has something, a command came, the stop, or until_ns (BEAT_NS at the longest).

        Returns False once the stage must end. The poll counts in ms: what is left below one is slept.
        """
        t_ns = now_ns()
        limit_ns = t_ns + BEAT_NS
        until_ns = limit_ns if until_ns is None else min(until_ns, limit_ns)
        self.row.beat()
        self.done()  # a stage that waits is done with what it took
        for each in self._inputs if self.spec.lock_step else ():
            each.give_credit()
        left_ms, rest = divmod(max(0, until_ns - t_ns), MS_NS)
        events = dict(self._poller.poll(left_ms))
        if self._ctl in events:
            self._take_messages()
        elif not events and rest and not self.stopping:
            left_ns = until_ns - now_ns()
            if left_ns > 0:
                time.sleep(left_ns / 1e9)
        return not self.stopping

    def done(self) -> None:
        """All that was taken from the inputs is dealt with."""
        for each in self._inputs:
            each.done()

    def wait_for(self, condition: Callable[[], bool], credits: list[Wake]) -> None:
        """Waits until condition holds or the stop; woken by credits."""
        poller = zmq.Poller()
        poller.register(self._ctl, zmq.POLLIN)
        for credit in credits:
            poller.register(credit.fd, zmq.POLLIN)
        while not condition() and not self.stopping:
            self.row.beat()
            if self._ctl in dict(poller.poll(BEAT_NS // MS_NS)):
                self._take_messages()

    def _take_messages(self) -> None:
        while self._ctl.poll(0):
            message = control.decode(self._ctl.recv())
            word = message.get("cmd", "")
            if word == "stop":
                self.stopping = True
            elif word == "config":
                self.config = config_module.trusted(message["config"])
                self.options = message["options"]
                self.paused = message["paused"]
                self._rev = message["rev"]
            elif word:
                self._commands.append((word, message))

    def close(self) -> None:
        """Lets go of sockets; the mappings end with the process."""
        self._ctl.close()
        self._bus.close(linger=200)  # last words: why an output ended
        self._zmq.term()


def empty_like(ring_end: ring.Reader) -> NDArray[Any]:
    """A buffer to `take` a ring's slots into."""
    return np.empty(ring_end.shape, ring_end.dtype)
