"""What may be asked of a session over ctl: each command checked, carried out whole or refused, and answered."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import attrs
import zmq

from lfpipe import config as config_module
from lfpipe.config import Config
from lfpipe.errors import UserError
from lfpipe.supervisor.agreement import Agreement
from lfpipe.supervisor.outcome import Outcome
from lfpipe.trace import check_trace
from lfpipe.transport import control
from lfpipe.transport.clock import now_ns

LEASE_S, MAX_LEASE_S = 5.0, 60.0  # of the output pictures
APPLY_S = 1.0  # how long an answer to `set` waits for the stages to work by it
LOCAL = ("pictures", "trace", "record")  # they speak of memory and files of this machine: not for who drives from another


class House(Protocol):
    """The session that the commands are for, as far as they see it."""

    agreement: Agreement
    outcome: Outcome | None

    def state(self) -> dict[str, Any]:
        """Of every stage, as `lfpipe monitor --once --json` prints it."""

    def applied(self, rev: int) -> bool:
        """Whether every stage works by revision rev."""

    def tell_stages(self, message: dict[str, Any]) -> None:
        """Sends to every stage."""


@attrs.frozen
class Client:
    """Who asked, where the answer goes, and whether they are on this machine."""

    socket: zmq.Socket[bytes]
    identity: bytes
    local: bool


@attrs.define
class _Applying:
    client: Client
    answer: dict[str, Any]
    rev: int
    until_ns: int


@attrs.define
class _Loading:
    client: Client
    process: subprocess.Popen[str]


def _usable(path: str, empty: bool = False) -> bool:
    """Whether a path means the same to the supervisor as to who sent it."""
    return (empty and not path) or (path.startswith("/") and "\0" not in path)


class Commands:
    """One method a command; what takes longer is looked at in `finish`. answer: sends to a client."""

    def __init__(self, house: House, answer: Callable[[Client, dict[str, Any]], None]) -> None:
        self._house, self._agreement, self._answer = house, house.agreement, answer
        self._applying: deque[_Applying] = deque()  # by revision, so by time as well
        self._loading: list[_Loading] = []

    @property
    def waited_for(self) -> bool:
        """Whether somebody waits for a change to be in force."""
        return bool(self._applying)

    def close(self) -> None:
        """Ends what is under way."""
        for loading in self._loading:
            loading.process.kill()
            loading.process.wait()

    def take(self, client: Client, parts: list[bytes]) -> None:
        """Carries a message out and answers it, now or when it is done."""
        try:
            if len(parts) != 1:
                raise control.BadMessage(f"{len(parts)} parts, one is spoken here")
            message = control.decode(parts[0])
            word = message.get("cmd")
            if word not in control.COMMANDS:
                raise control.BadMessage(f"unknown command {word!r}, there are {', '.join(control.COMMANDS)}")
            if word in LOCAL and not client.local:
                raise UserError(f"{word} is not taken from the network", "do it on the machine that runs the session")
            answer = getattr(self, f"_{word}")(client, message)
        except control.BadMessage as error:
            answer = {"ok": False, "error": str(error)}
        except UserError as error:
            answer = {"ok": False, "error": error.message, "remedy": error.remedy}
        if answer is not None:
            self._answer(client, answer)

    def _hello(self, client: Client, _: dict[str, Any]) -> dict[str, Any]:
        return {"ok": True, **self._agreement.message()}

    def _status(self, client: Client, _: dict[str, Any]) -> dict[str, Any]:
        return {
            "ok": True,
            "paused": self._agreement.paused,
            "config": config_module.to_dict(self._agreement.config),
            **self._house.state(),
        }

    def _set(self, client: Client, message: dict[str, Any]) -> None:
        sets = message.get("set")
        if not isinstance(sets, dict) or not sets:
            raise control.BadMessage("set needs a map of keys and values")
        config = config_module.updated(self._agreement.config, sets, live_only=True)
        self._check(config, self._agreement.options)
        self._apply(client, self._agreement.change(config=config), {"set": sets})

    def _pause(self, client: Client, _: dict[str, Any]) -> None:
        self._apply(client, self._agreement.change(paused=True), {"paused": True})

    def _resume(self, client: Client, _: dict[str, Any]) -> None:
        self._apply(client, self._agreement.change(paused=False), {"paused": False})

    def _recentre(self, client: Client, _: dict[str, Any]) -> dict[str, Any]:
        self._house.tell_stages({"cmd": "recentre"})
        return {"ok": True}

    def _pictures(self, client: Client, message: dict[str, Any]) -> dict[str, Any] | None:
        """The ring of output pictures, for lease_s; who goes on looking asks again in time."""
        lease_s = message.get("lease_s", LEASE_S)
        if isinstance(lease_s, bool) or not isinstance(lease_s, int | float) or not 0 < lease_s <= MAX_LEASE_S:
            raise control.BadMessage(f"pictures: lease_s {lease_s!r} is no time up to {MAX_LEASE_S:g} s")
        ring, changed = self._agreement.lend_pictures(float(lease_s))
        answer = {"ok": True, "ring": ring}
        if not changed:
            return answer
        self._apply(client, self._agreement.rev, answer)
        return None

    def _trace(self, client: Client, message: dict[str, Any]) -> None:
        """Starts a timeline into the file `path`, or ends the one that runs where path is empty."""
        path, running = message.get("path"), self._agreement.options.get("timeline", "")
        if not isinstance(path, str) or not _usable(path, empty=True):
            raise control.BadMessage("trace needs an absolute path, an empty one to stop")
        if path and running:
            raise UserError(f"a trace runs already, into {running}", "`lfpipe trace stop` ends it")
        if not path and not running:
            raise UserError("no trace runs", "`lfpipe trace start OUT.json` starts one")
        if path:
            check_trace(Path(path))
        rev = self._agreement.change(options={**self._agreement.options, "timeline": path})
        self._apply(client, rev, {"path": path or running})

    def _record(self, client: Client, message: dict[str, Any]) -> None:
        """Starts to record the camera into the folder `path`, or ends the recording where path is empty."""
        path, eyes = message.get("path"), message.get("eyes", False)
        running = self._agreement.options.get("record", "")
        if not isinstance(path, str) or not _usable(path, empty=True) or not isinstance(eyes, bool):
            raise control.BadMessage("record needs an absolute path, an empty one to stop")
        if path and running:
            raise UserError(f"a recording runs already, into {running}", "`lfpipe ctl record stop` ends it")
        if not path and not running:
            raise UserError("nothing is recorded", "`lfpipe ctl record start OUT` starts a recording")
        if path and not self._agreement.options["tracking"]:
            raise UserError("the session has no camera: its scene is one view", "`lfpipe record OUT` records without a scene")
        if path:
            from lfpipe.sequence.folder import check_out

            check_out(Path(path))
        options = {**self._agreement.options, "record": path, "record_eyes": eyes}
        self._apply(client, self._agreement.change(options=options), {"path": path or running})

    def _stop(self, client: Client, _: dict[str, Any]) -> dict[str, Any]:
        self._house.outcome = Outcome("stopped by command")
        return {"ok": True}

    def _load(self, client: Client, message: dict[str, Any]) -> None:
        """Packing may take long, and the supervisor must not: a process of its own checks and packs the scene."""
        scene = message.get("scene")
        if not isinstance(scene, str) or not _usable(scene):
            raise control.BadMessage("load needs the absolute path of a scene")
        if self._loading:
            raise UserError("another scene is being loaded", "wait until it shows, then load this one")
        sets = [f"--set=scene.{k}={json.dumps(v)}" for k, v in config_module.to_dict(self._agreement.config)["scene"].items()]
        command = [sys.executable, "-m", "lfpipe", "scene", "pack", "--json", *sets, "--", scene]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._loading.append(_Loading(client, process))

    def _apply(self, client: Client, rev: int, answer: dict[str, Any]) -> None:
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

    def finish(self) -> None:
        """Answers what has come to its end meanwhile."""
        for loading in [each for each in self._loading if each.process.poll() is not None]:
            self._loading.remove(loading)
            out, err = loading.process.communicate()
            if loading.process.returncode:
                why = err.strip().removeprefix("error: ") or "the scene cannot be read"
                self._answer(loading.client, {"ok": False, "error": why})
                continue
            packed = json.loads(out)
            options = {**self._agreement.options, "pack": packed["pack"], "tracking": packed["needs_tracking"]}
            try:
                self._check(self._agreement.config, options)
            except UserError as error:
                self._answer(loading.client, {"ok": False, "error": error.message, "remedy": error.remedy})
                continue
            self._apply(loading.client, self._agreement.change(options=options), {"pack": packed["pack"]})
        while self._applying:
            waiting = self._applying[0]
            done = self._house.applied(waiting.rev)
            if not done and now_ns() <= waiting.until_ns:
                return
            self._applying.popleft()
            self._answer(waiting.client, {**waiting.answer, "applied": done})
