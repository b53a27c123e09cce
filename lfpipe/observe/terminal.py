"""The loops of `lfpipe monitor` in a terminal or a pipe."""

import json
import os
import sys
import time
from contextlib import closing
from typing import Any

from lfpipe.errors import UserError
from lfpipe.host.terminal import Keyboard
from lfpipe.observe.session_commands import ask, press
from lfpipe.observe.session_reader import FollowingReader, Watch
from lfpipe.observe.state_text import print_state, screen_text, waiting_text
from lfpipe.supervisor.rundir import find

PERIOD_S = 0.25
NOTE_S = 5.0  # display time of the answer to a key


def run(name: str, once: bool, as_json: bool) -> None:
    """Shows the session of that name: one state, JSON lines until it ends, or the screen of a terminal, where there is one.
    Raises UserError if it does not run."""
    redraws = sys.stdout.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown")
    with closing(Watch(find(name))) as watch:
        if not as_json and (once or not redraws):
            print_state(watch.read())
        while as_json:
            print(json.dumps(watch.read()), flush=True)
            if once or not watch.living():
                return
            time.sleep(PERIOD_S)
    if redraws and not once:
        screen(name)


def screen(name: str) -> None:
    """The terminal screen, until q or Ctrl-C. It waits for a session that has ended to start again."""
    from rich.console import Console
    from rich.live import Live

    follower, console = FollowingReader(name), Console()
    hello: dict[str, Any] = {}
    revision, note, note_end = -1, "", 0.0
    with Keyboard() as keyboard, Live(console=console, screen=True, auto_refresh=False) as live:
        due = time.monotonic()
        while True:
            state = follower.read()
            if state is None:
                revision = -1
                live.update(waiting_text(name), refresh=True)
            else:
                if state["config_rev"] != revision:
                    hello, revision = _hello(name), state["config_rev"]
                note = note if time.monotonic() < note_end else ""
                live.update(screen_text(state, hello, note), refresh=True)
            due = max(due + PERIOD_S, time.monotonic())
            while left_s := max(0.0, due - time.monotonic()):
                try:
                    key = keyboard.key(left_s)
                except KeyboardInterrupt:
                    key = "q"
                if key == "q":
                    follower.close()
                    return
                if key == "r":
                    follower.reset()
                if key:
                    note, note_end = "counts reset" if key == "r" else press(name, key), time.monotonic() + NOTE_S


def _hello(name: str) -> dict[str, Any]:
    """The session's settings; empty if it does not answer."""
    try:
        return ask(name, {"cmd": "hello"}, 0.5)
    except UserError:
        return {}
