"""What the supervisor refuses, and how it says so."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from lfpipe.config.session_options import NoViewer
from lfpipe.supervisor import rundir
from lfpipe.supervisor.requests import respond
from lfpipe.transport.control import Session
from tests.supervisor.states import made_state

NAMES = ("", "..", "a/b", "a\n", "-a", "a b", "a" * 33, "é", "١", "a*", "a\0", "$(id)", "\udcff")


def in_run_dir(place: str, here: Path) -> None:
    """A session whose directories would be there."""
    (here / "file").touch()
    with pytest.MonkeyPatch.context() as patch:
        path = str(here / place) if place.isalpha() else place
        patch.setenv("LFPIPE_RUN_DIR", path)
        rundir.acquire(Session("a"))


MESSAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "a session that does not run": (
        lambda here: rundir.find("elsewhere.nobody"),
        "no session 'elsewhere.nobody' is running\n  remedy: start one: `lfpipe up --demo`",
    ),
    "a name that is no session's": (
        lambda here: Session("../x"),
        (
            "--session '../x' is not a valid name\n  remedy: use 1 to 32 letters, digits, _ and .,"
            " beginning with a letter or digit"
        ),
    ),
    **{
        f"the name {text!r}": (
            partial(lambda name, here: Session(name), text),
            f"--session {text!r} is not a valid name … 1 to 32",
        )
        for text in NAMES
    },
    **{
        f"the run directory {place}": (
            partial(in_run_dir, place),
            " … LFPIPE_RUN_DIR",
        )
        for place in ("./run", "~/run", "/tmp/\udcff", "missing", "file", "/" + "x" * 200)
    },
    "a second recording": (
        lambda here: respond(made_state(record="/theirs"), {"cmd": "record", "path": "/mine"}, 0),
        "a recording to /theirs is already running\n  remedy: end it with `lfpipe ctl record stop`",
    ),
    "no trace to stop": (
        lambda here: respond(made_state(), {"cmd": "trace", "path": ""}, 0),
        "no trace is running\n  remedy: start one with `lfpipe trace start OUT`",
    ),
    "a recording of a single view": (
        lambda here: respond(made_state(viewer=NoViewer()), {"cmd": "record", "path": "/x"}, 0),
        (
            "no camera is in use: the scene is a single view\n  remedy: record without a scene:"
            " `lfpipe record OUT`"
        ),
    ),
    "a scene beyond the playlist": (
        lambda here: respond(made_state(playlist=("/a", "/b")), {"cmd": "load", "at": 2}, 0),
        "no scene 2 in the playlist\n  remedy: choose 0 to 1",
    ),
}
