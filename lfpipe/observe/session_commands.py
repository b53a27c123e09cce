"""Commands of monitors to a session, over ctl: what the keys of the terminal do. The page sends `ask` alone."""

import time
from functools import partial
from pathlib import Path
from typing import Any

from lfpipe.config import choices
from lfpipe.errors import UserError
from lfpipe.observe.timeline import finish_trace
from lfpipe.supervisor.rundir import find
from lfpipe.transport import control


def ask(name: str, message: dict[str, Any], timeout_s: float = 2.0) -> dict[str, Any]:
    """Sends one command to the session that has this name now; returns its answer. Raises UserError."""
    return control.request(find(name).run_dir, message, timeout_s)


def press(name: str, key: str) -> str:
    """Does what a key means; returns one line for the person, "" for an unknown key."""
    if key not in ("p", "w", "m", "c", "t"):
        return ""
    try:
        return _done(name, key)
    except UserError as error:
        return f"{error.message} ({error.remedy})" if error.remedy else error.message


def _done(name: str, key: str) -> str:
    state = ask(name, {"cmd": "hello"})
    render = state["config"]["render"]
    if key == "p":
        ask(name, {"cmd": "resume" if state["paused"] else "pause"})
        return "resumed" if state["paused"] else "paused: p resumes"
    if key == "w":
        method = "auto" if render["method"] == "nearest" else "nearest"
        ask(name, {"cmd": "set", "set": {"render.method": method}})
        return f"views: {method}"
    if key == "m":
        modes = choices("render.anaglyph")
        mode = modes[(modes.index(render["anaglyph"]) + 1) % len(modes)]
        ask(name, {"cmd": "set", "set": {"render.anaglyph": mode}})
        return f"mode: {mode}"
    if key == "c":
        ask(name, {"cmd": "recentre"})
        return "recentred"
    if state["options"].get("timeline"):
        return f"timeline: {finish_trace(partial(ask, name), None)}"
    out = Path(time.strftime("lfpipe-%Y%m%d-%H%M%S.json")).resolve()
    ask(name, {"cmd": "trace", "path": f"{out}.part"}, control.FILE_CHECK_TIMEOUT_S)
    return "recording a timeline: t ends it"
