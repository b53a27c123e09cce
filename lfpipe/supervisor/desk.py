"""The supervisor's front desk: takes commands over ctl, answers them, passes telemetry from bus on to tap."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import zmq

from lfpipe import config as config_module
from lfpipe.errors import UserError
from lfpipe.observe.snapshot import snapshot
from lfpipe.observe.trace import check_trace
from lfpipe.supervisor.outcome import Outcome
from lfpipe.transport import control
from lfpipe.transport.clock import now_ns

if TYPE_CHECKING:
    from lfpipe.supervisor.supervisor import Supervisor

LEASE_S, MAX_LEASE_S = 5.0, 60.0  # of the output pictures
APPLY_S = 1.0  # how long an answer to `set` waits for the stages to work by it


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


class Desk:
    """Three sockets, bound in the run directory; nothing here waits."""

    def __init__(self, ctx: zmq.Context[zmq.Socket[bytes]], supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._applying: list[_Applying] = []
        self._loading: list[_Loading] = []
        run_dir = supervisor.session.run_dir
        self._ctl, self._bus, self._tap = (ctx.socket(kind) for kind in (zmq.ROUTER, zmq.PULL, zmq.XPUB))
        self._ctl.setsockopt(zmq.ROUTER_HANDOVER, 1)  # a restarted stage comes back under its old name
        for socket, name in ((self._ctl, "ctl"), (self._bus, "bus"), (self._tap, "tap")):
            socket.setsockopt(zmq.MAXMSGSIZE, 16 * control.MAX_BYTES)  # beyond MAX_BYTES an answer says so, beyond this none
            socket.bind(control.address(run_dir, name))
        self.sockets = [self._ctl, self._bus]

    def close(self) -> None:
        """Ends what is under way; the answer to it is an error."""
        for loading in self._loading:
            loading.process.kill()
            loading.process.wait()
        for socket in (self._ctl, self._bus, self._tap):
            socket.close()

    def send(self, stage: str, message: dict[str, Any]) -> None:
        """To one stage; lost if it is not connected (it says hello when it is)."""
        self._ctl.send_multipart([stage.encode(), control.encode(message)], zmq.NOBLOCK)

    def publish(self, topic: str, **values: Any) -> None:
        """To whoever listens on the tap."""
        self._tap.send(control.encode({"topic": topic, "t_ns": now_ns(), **values}), zmq.NOBLOCK)

    def serve(self, most: int = 64) -> None:
        """Takes what has arrived, at most so many messages, so that a flood cannot keep the supervisor from its children."""
        for _ in range(most):
            if not self._ctl.poll(0):
                break
            parts = self._ctl.recv_multipart()
            if len(parts) != 2:
                self._answer(parts[0], {"ok": False, "error": f"{len(parts) - 1} parts, one is spoken here"})
                continue
            self._take(*parts)
        for _ in range(most):
            if not self._bus.poll(0):
                break
            data = self._bus.recv()
            self._tap.send(data, zmq.NOBLOCK)
            with contextlib.suppress(control.BadMessage):
                self._supervisor.hear(control.decode(data))
        self._finish()

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
        if not isinstance(path, str) or "\0" in path:
            raise control.BadMessage("trace needs a path, an empty one to stop")
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
        if not isinstance(path, str) or "\0" in path or not isinstance(eyes, bool):
            raise control.BadMessage("record needs a path, an empty one to stop")
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
        if not isinstance(scene, str) or not scene or "\0" in scene:
            raise control.BadMessage("load needs the path of a scene")
        sets = [f"--set=scene.{k}={json.dumps(v)}" for k, v in config_module.to_dict(self._supervisor.config)["scene"].items()]
        command = [sys.executable, "-m", "lfpipe", "scene", "pack", "--json", *sets, "--", scene]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._loading.append(_Loading(client, process))

    def _apply(self, client: bytes, rev: int, answer: dict[str, Any]) -> None:
        self._applying.append(_Applying(client, {"ok": True, **answer}, rev, now_ns() + int(APPLY_S * 1e9)))

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
            self._apply(loading.client, self._supervisor.change(options=options), {"pack": packed["pack"]})
        for waiting in list(self._applying):
            done = self._supervisor.applied(waiting.rev)
            if done or now_ns() > waiting.until_ns:
                self._applying.remove(waiting)
                self._answer(waiting.client, {**waiting.answer, "applied": done})
