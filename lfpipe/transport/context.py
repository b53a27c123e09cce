"""What a stage is given: its configuration, its rings with their wakes, its status row, and one place to wait."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import attrs
import zmq

from lfpipe import config as config_module
from lfpipe.config import Config, SessionOptions
from lfpipe.host.wake import Wake
from lfpipe.transport import control, status
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.ends import Input, Output
from lfpipe.transport.session import Session
from lfpipe.transport.status import State

BEAT_NS = 100 * MS_NS  # the longest a stage may wait without showing that it lives


@attrs.frozen
class StageSpec:
    """All that a stage's process gets at its start, pickled.

    consumers: ring -> stages that read it. others: the other stages of the session. cpus: cores to run on, none for all.
    nice: niceness, None for the supervisor's.
    """

    name: str
    module: str
    session: Session
    config: Config
    rev: int
    options: SessionOptions
    consumers: dict[str, list[str]]
    others: tuple[str, ...]
    cpus: tuple[int, ...] = ()
    nice: int | None = None

    def ring_index(self, name: str) -> int:
        """Where a ring's credit lies in a status row."""
        return list(self.consumers).index(name)


class Context:
    """A stage's world. `wait` is the only place where a stage sleeps: it beats, takes commands and notices the stop."""

    def __init__(self, spec: StageSpec) -> None:
        self.spec = spec
        self.config = spec.config
        self.table = status.Table(spec.session.segment("status"), writable=True)
        self.row = status.Row(self.table.rows[spec.name])
        self.options = spec.options
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
        return made

    def ready(self) -> None:
        """Set-up is over: from now on a missing beat means a hang."""
        self.row["epoch"] += 1
        self.row.beat()  # before it counts: who is held up between the two lines has not hung
        self.row["ready_ns"] = now_ns()
        self.row["state"] = State.RUNNING

    @contextlib.contextmanager
    def busy_with(self, words: str) -> Iterator[None]:
        """Around calls that may wait for a disk: meanwhile the stage is judged by what it does, not by its beat.

        words: what it does, for monitors, at most 32 bytes. See `lfpipe.supervisor.judge`.
        """
        self.row.set_busy(words)
        try:
            yield
        finally:
            self.row.set_busy("")

    @contextlib.contextmanager
    def setting_up(self, words: str) -> Iterator[None]:
        """As `busy_with`, around work that may also compute for long: the stage is judged as at its start."""
        before, self.row["state"] = self.row["state"], State.STARTING
        try:
            with self.busy_with(words):
                yield
        finally:
            self.row["state"] = before

    @contextlib.contextmanager
    def saving(self, words: str) -> Iterator[None]:
        """As `busy_with`, around what writes results at the end: who ends the session waits for it."""
        self.row["state"] = State.STOPPING
        with self.busy_with(words):
            yield

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
        for each in self._inputs if self.spec.options.lock_step else ():
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
                self.options = SessionOptions.from_dict(message["options"])
                self.paused = message["paused"]
                self._rev = message["rev"]
            elif word:
                self._commands.append((word, message))

    def close(self) -> None:
        """Lets go of sockets; the mappings end with the process."""
        self._ctl.close()
        self._bus.close(linger=200)  # last words: why an output ended
        self._zmq.term()
