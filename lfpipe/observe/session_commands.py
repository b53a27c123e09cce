"""Commands of a monitor to a session, over ctl: keys of the terminal, buttons of the page."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfpipe.config import choices
from lfpipe.errors import UserError
from lfpipe.observe.timeline import finish_trace
from lfpipe.supervisor.rundir import find
from lfpipe.transport import control


class SessionCommands:
    """Sends commands to the session that has this name at the time. Every method raises UserError as ctl would."""

    def __init__(self, name: str) -> None:
        self.name = name

    def ask(self, message: dict[str, Any], timeout_s: float = 2.0) -> dict[str, Any]:
        """Sends one command and returns its answer."""
        return control.request(find(self.name).run_dir, message, timeout_s)

    def pause(self) -> str:
        """Freezes the picture, or resumes."""
        paused = bool(self.ask({"cmd": "hello"})["paused"])
        self.ask({"cmd": "resume" if paused else "pause"})
        return "resumed" if paused else "paused: p resumes"

    def warp(self) -> str:
        """Toggles render.method between nearest and auto."""
        off = self.ask({"cmd": "hello"})["config"]["render"]["method"] == "nearest"
        self.ask({"cmd": "set", "set": {"render.method": "auto" if off else "nearest"}})
        return "views: auto" if off else "views: nearest"

    def mode(self) -> str:
        """Selects the next anaglyph mode."""
        now = self.ask({"cmd": "hello"})["config"]["render"]["anaglyph"]
        modes = choices("render.anaglyph")
        mode = modes[(modes.index(now) + 1) % len(modes)]
        self.ask({"cmd": "set", "set": {"render.anaglyph": mode}})
        return f"mode: {mode}"

    def recentre(self) -> str:
        """Makes the viewer's position the centre of the grid."""
        self.ask({"cmd": "recentre"})
        return "recentred"

    def trace(self) -> str:
        """Starts a timeline, or ends the running one and converts it for Perfetto."""
        running = str(self.ask({"cmd": "hello"})["options"].get("timeline", ""))
        if running:
            return f"timeline: {finish_trace(self.ask, None)}"
        out = Path(time.strftime("lfpipe-%Y%m%d-%H%M%S.json")).resolve()
        self.ask({"cmd": "trace", "path": f"{out}.part"}, control.FILE_CHECK_TIMEOUT_S)
        return "recording a timeline: t ends it"

    def press(self, key: str) -> str:
        """Runs the command of a key and returns one line for the user; "" for an unknown key."""
        actions: dict[str, Callable[[], str]] = {
            "p": self.pause, "w": self.warp, "m": self.mode, "c": self.recentre, "t": self.trace
        }  # fmt: skip
        try:
            return actions[key]() if key in actions else ""
        except UserError as error:
            return f"{error.message} ({error.remedy})" if error.remedy else error.message
