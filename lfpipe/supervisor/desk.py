"""The supervisor's front desk: takes commands, over ctl and from the network, answers them, passes telemetry on to tap."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import zmq

from lfpipe import config as config_module
from lfpipe.config import Config
from lfpipe.errors import UserError
from lfpipe.observe.snapshot import snapshot
from lfpipe.observe.trace import check_trace
from lfpipe.supervisor.intake import Intake
from lfpipe.supervisor.outcome import Outcome
from lfpipe.transport import control, curve
from lfpipe.transport.clock import MS_NS, now_ns

if TYPE_CHECKING:
    from lfpipe.supervisor.supervisor import Supervisor

LEASE_S, MAX_LEASE_S = 5.0, 60.0  # of the output pictures
APPLY_S = 1.0  # how long an answer to `set` waits for the stages to work by it
APPLY_LOOK_MS = 4  # how often it is looked at meanwhile
LOCAL = ("pictures", "trace", "record")  # they speak of memory and files of this machine: not for who drives from another


def _usable(path: str, empty: bool = False) -> bool:
    """Whether a path means the same to the supervisor as to who sent it."""
    return (empty and not path) or (path.startswith("/") and "\0" not in path)


@attrs.frozen
class _Client:
    """Who asked, and where the answer goes."""

    socket: zmq.Socket[bytes]
    identity: bytes


@attrs.define
class _Applying:
    client: _Client
    answer: dict[str, Any]
    rev: int
    until_ns: int


@attrs.define
class _Loading:
    client: _Client
    process: subprocess.Popen[str]


class Desk:
    """Three sockets, bound in the run directory, and one on the network where control.bind says so; nothing here waits.

    Raises UserError where that cannot be.
    """

    def __init__(self, ctx: zmq.Context[zmq.Socket[bytes]], supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._applying: deque[_Applying] = deque()  # by revision, so by time as well
        self._loading: list[_Loading] = []
        run_dir = supervisor.session.run_dir
        self._ctl, self._bus, self._tap = (ctx.socket(kind) for kind in (zmq.ROUTER, zmq.PULL, zmq.XPUB))
        self._ctl.setsockopt(zmq.ROUTER_HANDOVER, 1)  # a restarted stage comes back under its old name
        for socket, name in ((self._ctl, "ctl"), (self._bus, "bus"), (self._tap, "tap")):
            control.limit(socket)
            socket.bind(control.address(run_dir, name))
            (run_dir / name).chmod(0o600)
        settings = supervisor.config.control
        self._door = curve.Door(settings.bind, curve.folder(settings.keys)) if settings.bind != "ipc" else None
        self._commands, self._told = [Intake(self._ctl)], Intake(self._bus)
        self._asked: list[Intake] = []
        if self._door is not None:
            self._commands.append(Intake(self._door.ctl))
            self._asked.append(Intake(self._door.bell))
        self._intakes = [*self._commands, self._told, *self._asked]
        self._news: dict[str, dict[str, Any]] | None = None  # while messages are taken: only the last configuration counts

    def close(self) -> None:
        """Ends what is under way; the answer to it is an error."""
        for loading in self._loading:
            loading.process.kill()
            loading.process.wait()
        for socket in (self._ctl, self._bus, self._tap):
            socket.close()
        if self._door is not None:
            self._door.close()

    @property
    def sockets(self) -> list[zmq.Socket[bytes]]:
        """Those worth waking for now."""
        return [intake.socket for intake in self._intakes if not intake.rest_ns()]

    def wait_ms(self, most_ms: int) -> int:
        """How long the supervisor may sleep, most_ms at the most, where none of `sockets` wakes it."""
        rests = [intake.rest_ns() // MS_NS + 1 for intake in self._intakes if intake.rest_ns()]
        return min([most_ms, *rests, *([APPLY_LOOK_MS] if self._applying else [])])

    def send(self, stage: str, message: dict[str, Any]) -> None:
        """To one stage; lost if it is not connected (it says hello when it is)."""
        if self._news is not None and message["cmd"] == "config":
            self._news[stage] = message
            return
        self._ctl.send_multipart([stage.encode(), control.encode(message)], zmq.NOBLOCK)

    def publish(self, topic: str, **values: Any) -> None:
        """To whoever listens on the tap."""
        self._tap.send(control.encode({"topic": topic, "t_ns": now_ns(), **values}), zmq.NOBLOCK)

    def serve(self) -> None:
        """Takes what has arrived, as far as its time goes."""
        self._news = {}
        for intake in self._commands:
            for identity, *parts in intake.messages():
                self._take(_Client(intake.socket, identity), parts)
        for (data,) in (parts for parts in self._told.messages() if len(parts) == 1):
            with contextlib.suppress(control.BadMessage):
                message = control.decode(data)
                self._tap.send(data, zmq.NOBLOCK)
                self._supervisor.hear(message)
        for question in (parts for intake in self._asked for parts in intake.messages()):
            assert self._door is not None
            self._door.answer(question)
        while self._tap.poll(0):
            self._tap.recv()  # who subscribes and leaves is told to us, and would be kept
        self._finish()
        news, self._news = self._news, None
        for stage, message in news.items():
            self.send(stage, message)

    def _take(self, client: _Client, parts: list[bytes]) -> None:
        try:
            if len(parts) != 1:
                raise control.BadMessage(f"{len(parts)} parts, one is spoken here")
            message = control.decode(parts[0])
            word = message.get("cmd")
            if word not in control.COMMANDS:
                raise control.BadMessage(f"unknown command {word!r}, there are {', '.join(control.COMMANDS)}")
            if word in LOCAL and client.socket is not self._ctl:
                raise UserError(f"{word} is not taken from the network", "do it on the machine that runs the session")
            answer = getattr(self, f"_{word}")(client, message)
        except control.BadMessage as error:
            answer = {"ok": False, "error": str(error)}
        except UserError as error:
            answer = {"ok": False, "error": error.message, "remedy": error.remedy}
        if answer is not None:
            self._answer(client, answer)

    def _answer(self, client: _Client, message: dict[str, Any]) -> None:
        client.socket.send_multipart([client.identity, control.encode({"rev": self._supervisor.rev, **message})], zmq.NOBLOCK)

    def _hello(self, client: _Client, _: dict[str, Any]) -> dict[str, Any]:
        return {"ok": True, **self._supervisor.snapshot()}

    def _status(self, client: _Client, _: dict[str, Any]) -> dict[str, Any]:
        supervisor = self._supervisor
        return {
            "ok": True,
            "paused": supervisor.paused,
            "config": config_module.to_dict(supervisor.config),
            **snapshot(supervisor.session.name, supervisor.table, supervisor.started_ns),
        }

    def _set(self, client: _Client, message: dict[str, Any]) -> None:
        sets = message.get("set")
        if not isinstance(sets, dict) or not sets:
            raise control.BadMessage("set needs a map of keys and values")
        config = config_module.updated(self._supervisor.config, sets, live_only=True)
        self._check(config, self._supervisor.options)
        self._apply(client, self._supervisor.change(config=config), {"set": sets})

    def _pause(self, client: _Client, _: dict[str, Any]) -> None:
        self._apply(client, self._supervisor.change(paused=True), {"paused": True})

    def _resume(self, client: _Client, _: dict[str, Any]) -> None:
        self._apply(client, self._supervisor.change(paused=False), {"paused": False})

    def _recentre(self, client: _Client, _: dict[str, Any]) -> dict[str, Any]:
        for name in self._supervisor.processes:
            self.send(name, {"cmd": "recentre"})
        return {"ok": True}

    def _pictures(self, client: _Client, message: dict[str, Any]) -> dict[str, Any] | None:
        """The ring of output pictures, for lease_s; who goes on looking asks again in time."""
        lease_s = message.get("lease_s", LEASE_S)
        if isinstance(lease_s, bool) or not isinstance(lease_s, int | float) or not 0 < lease_s <= MAX_LEASE_S:
            raise control.BadMessage(f"pictures: lease_s {lease_s!r} is no time up to {MAX_LEASE_S:g} s")
        changed = self._supervisor.lend_pictures(float(lease_s))
        answer = {"ok": True, "ring": self._supervisor.loan.part}
        if not changed:
            return answer
        self._apply(client, self._supervisor.rev, answer)
        return None

    def _trace(self, client: _Client, message: dict[str, Any]) -> None:
        """Starts a timeline into the file `path`, or ends the one that runs where path is empty."""
        path, running = message.get("path"), self._supervisor.options.get("timeline", "")
        if not isinstance(path, str) or not _usable(path, empty=True):
            raise control.BadMessage("trace needs an absolute path, an empty one to stop")
        if path and running:
            raise UserError(f"a trace runs already, into {running}", "`lfpipe trace stop` ends it")
        if not path and not running:
            raise UserError("no trace runs", "`lfpipe trace start OUT.json` starts one")
        if path:
            check_trace(Path(path))
        rev = self._supervisor.change(options={**self._supervisor.options, "timeline": path})
        self._apply(client, rev, {"path": path or running})

    def _record(self, client: _Client, message: dict[str, Any]) -> None:
        """Starts to record the camera into the folder `path`, or ends the recording where path is empty."""
        path, eyes = message.get("path"), message.get("eyes", False)
        running = self._supervisor.options.get("record", "")
        if not isinstance(path, str) or not _usable(path, empty=True) or not isinstance(eyes, bool):
            raise control.BadMessage("record needs an absolute path, an empty one to stop")
        if path and running:
            raise UserError(f"a recording runs already, into {running}", "`lfpipe ctl record stop` ends it")
        if not path and not running:
            raise UserError("nothing is recorded", "`lfpipe ctl record start OUT` starts a recording")
        if path and not self._supervisor.options["tracking"]:
            raise UserError("the session has no camera: its scene is one view", "`lfpipe record OUT` records without a scene")
        if path:
            from lfpipe.replay.sequence import check_out

            check_out(Path(path))
        options = {**self._supervisor.options, "record": path, "record_eyes": eyes}
        self._apply(client, self._supervisor.change(options=options), {"path": path or running})

    def _stop(self, client: _Client, _: dict[str, Any]) -> dict[str, Any]:
        self._supervisor.outcome = Outcome("stopped by command")
        return {"ok": True}

    def _load(self, client: _Client, message: dict[str, Any]) -> None:
        """Packing may take long, and the supervisor must not: a process of its own checks and packs the scene."""
        scene = message.get("scene")
        if not isinstance(scene, str) or not _usable(scene):
            raise control.BadMessage("load needs the absolute path of a scene")
        if self._loading:
            raise UserError("another scene is being loaded", "wait until it shows, then load this one")
        sets = [f"--set=scene.{k}={json.dumps(v)}" for k, v in config_module.to_dict(self._supervisor.config)["scene"].items()]
        command = [sys.executable, "-m", "lfpipe", "scene", "pack", "--json", *sets, "--", scene]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._loading.append(_Loading(client, process))

    def _apply(self, client: _Client, rev: int, answer: dict[str, Any]) -> None:
        self._applying.append(_Applying(client, {"ok": True, **answer}, rev, now_ns() + int(APPLY_S * 1e9)))

    @staticmethod
    def _check(config: Config, options: dict[str, Any]) -> None:
        if options["pack"]:
            from lfpipe.render.check import check_together

            check_together(config, Path(options["pack"]))

    def refuse(self, why: str) -> None:
        """Answers all who wait for a change to be applied that it was taken back."""
        while self._applying:
            self._answer(self._applying.popleft().client, {"ok": False, "error": why})

    def _finish(self) -> None:
        for loading in [each for each in self._loading if each.process.poll() is not None]:
            self._loading.remove(loading)
            out, err = loading.process.communicate()
            if loading.process.returncode:
                why = err.strip().removeprefix("error: ") or "the scene cannot be read"
                self._answer(loading.client, {"ok": False, "error": why})
                continue
            packed = json.loads(out)
            options = {**self._supervisor.options, "pack": packed["pack"], "tracking": packed["needs_tracking"]}
            try:
                self._check(self._supervisor.config, options)
            except UserError as error:
                self._answer(loading.client, {"ok": False, "error": error.message, "remedy": error.remedy})
                continue
            self._apply(loading.client, self._supervisor.change(options=options), {"pack": packed["pack"]})
        while self._applying:
            waiting = self._applying[0]
            done = self._supervisor.applied(waiting.rev)
            if not done and now_ns() <= waiting.until_ns:
                return
            self._applying.popleft()
            self._answer(waiting.client, {**waiting.answer, "applied": done})
