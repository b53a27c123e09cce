"""The supervisor's front desk: takes commands over ctl, answers them, passes telemetry from bus on to tap.

Whoever may speak to it may also shout: it takes so many messages in so much time and lets the rest wait in their senders,
in turn, so that neither a frame nor another client waits for a flood.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import zmq

from lfpipe import config as config_module
from lfpipe.config import Config
from lfpipe.errors import UserError
from lfpipe.observe.snapshot import snapshot
from lfpipe.observe.trace import check_trace
from lfpipe.supervisor.outcome import Outcome
from lfpipe.transport import control
from lfpipe.transport.clock import MS_NS, now_ns

if TYPE_CHECKING:
    from lfpipe.supervisor.supervisor import Supervisor

LEASE_S, MAX_LEASE_S = 5.0, 60.0  # of the output pictures
APPLY_S = 1.0  # how long an answer to `set` waits for the stages to work by it
APPLY_LOOK_MS = 4  # how often it is looked at meanwhile
SLICE, SLICE_NS = 32, 20 * MS_NS  # messages of one socket in so much time: 15 % of a core at the most
QUEUE = 64  # messages that wait on either side, per client


def _usable(path: str, empty: bool = False) -> bool:
    """Whether a path means the same to the supervisor as to who sent it."""
    return (empty and not path) or (path.startswith("/") and "\0" not in path)


@attrs.define
class _Applying:
    client: bytes
    answer: dict[str, Any]
    rev: int
    until_ns: int


@attrs.define
class _Loading:
    client: bytes
    process: subprocess.Popen[str]


@attrs.define
class _Intake:
    """What comes in by one socket, SLICE messages in SLICE_NS. ZeroMQ takes one of each client in turn."""

    socket: zmq.Socket[bytes]
    _left: int = SLICE
    _until_ns: int = 0

    def messages(self) -> Iterator[list[bytes]]:
        """Those that are there and may be taken now."""
        if now_ns() >= self._until_ns:
            self._left, self._until_ns = SLICE, now_ns() + SLICE_NS
        while self._left and self.socket.poll(0):
            self._left -= 1
            yield self.socket.recv_multipart()

    def rest_ns(self) -> int:
        """How long it will take no more."""
        return 0 if self._left else max(0, self._until_ns - now_ns())


class Desk:
    """Three sockets, bound in the run directory; nothing here waits."""

    def __init__(self, ctx: zmq.Context[zmq.Socket[bytes]], supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._applying: deque[_Applying] = deque()  # by revision, so by time as well
        self._loading: list[_Loading] = []
        run_dir = supervisor.session.run_dir
        self._ctl, self._bus, self._tap = (ctx.socket(kind) for kind in (zmq.ROUTER, zmq.PULL, zmq.XPUB))
        self._ctl.setsockopt(zmq.ROUTER_HANDOVER, 1)  # a restarted stage comes back under its old name
        for socket, name in ((self._ctl, "ctl"), (self._bus, "bus"), (self._tap, "tap")):
            socket.setsockopt(zmq.MAXMSGSIZE, 2 * control.MAX_BYTES)  # beyond MAX_BYTES an answer says so, beyond this none
            socket.set_hwm(QUEUE)
            socket.bind(control.address(run_dir, name))
        self._intakes = [_Intake(self._ctl), _Intake(self._bus)]
        self._news: dict[str, dict[str, Any]] | None = None  # while messages are taken: only the last configuration counts

    def close(self) -> None:
        """Ends what is under way; the answer to it is an error."""
        for loading in self._loading:
            loading.process.kill()
            loading.process.wait()
        for socket in (self._ctl, self._bus, self._tap):
            socket.close()

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
        ctl, bus = self._intakes
        self._news = {}
        for parts in ctl.messages():
            if len(parts) != 2:
                self._answer(parts[0], {"ok": False, "error": f"{len(parts) - 1} parts, one is spoken here"})
                continue
            self._take(*parts)
        for (data,) in (parts for parts in bus.messages() if len(parts) == 1):
            with contextlib.suppress(control.BadMessage):
                message = control.decode(data)
                self._tap.send(data, zmq.NOBLOCK)
                self._supervisor.hear(message)
        while self._tap.poll(0):
            self._tap.recv()  # who subscribes and leaves is told to us, and would be kept
        self._finish()
        news, self._news = self._news, None
        for stage, message in news.items():
            self.send(stage, message)

    def _take(self, client: bytes, data: bytes) -> None:
        try:
            message = control.decode(data)
            word = message.get("cmd")
            if word not in control.COMMANDS:
                raise control.BadMessage(f"unknown command {word!r}, there are {', '.join(control.COMMANDS)}")
            answer = getattr(self, f"_{word}")(client, message)
        except control.BadMessage as error:
            answer = {"ok": False, "error": str(error)}
        except UserError as error:
            answer = {"ok": False, "error": error.message, "remedy": error.remedy}
        if answer is not None:
            self._answer(client, answer)

    def _answer(self, client: bytes, message: dict[str, Any]) -> None:
        self._ctl.send_multipart([client, control.encode({"rev": self._supervisor.rev, **message})], zmq.NOBLOCK)

    def _hello(self, client: bytes, _: dict[str, Any]) -> dict[str, Any]:
        return {"ok": True, **self._supervisor.snapshot()}

    def _status(self, client: bytes, _: dict[str, Any]) -> dict[str, Any]:
        supervisor = self._supervisor
        return {
            "ok": True,
            "paused": supervisor.paused,
            "config": config_module.to_dict(supervisor.config),
            **snapshot(supervisor.session.name, supervisor.table, supervisor.started_ns),
        }

    def _set(self, client: bytes, message: dict[str, Any]) -> None:
        sets = message.get("set")
        if not isinstance(sets, dict) or not sets:
            raise control.BadMessage("set needs a map of keys and values")
        config = config_module.updated(self._supervisor.config, sets, live_only=True)
        self._check(config, self._supervisor.options)
        self._apply(client, self._supervisor.change(config=config), {"set": sets})

    def _pause(self, client: bytes, _: dict[str, Any]) -> None:
        self._apply(client, self._supervisor.change(paused=True), {"paused": True})

    def _resume(self, client: bytes, _: dict[str, Any]) -> None:
        self._apply(client, self._supervisor.change(paused=False), {"paused": False})

    def _recentre(self, client: bytes, _: dict[str, Any]) -> dict[str, Any]:
        for name in self._supervisor.processes:
            self.send(name, {"cmd": "recentre"})
        return {"ok": True}

    def _pictures(self, client: bytes, message: dict[str, Any]) -> dict[str, Any] | None:
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

    def _trace(self, client: bytes, message: dict[str, Any]) -> None:
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

    def _record(self, client: bytes, message: dict[str, Any]) -> None:
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

    def _stop(self, client: bytes, _: dict[str, Any]) -> dict[str, Any]:
        self._supervisor.outcome = Outcome("stopped by command")
        return {"ok": True}

    def _load(self, client: bytes, message: dict[str, Any]) -> None:
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

    def _apply(self, client: bytes, rev: int, answer: dict[str, Any]) -> None:
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
