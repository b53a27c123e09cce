"""The loops of `lfpipe monitor` in a terminal or a pipe."""

import contextlib
import json
import os
import sys
import time
from typing import Any

from lfpipe.errors import UserError
from lfpipe.host.terminal import Keyboard
from lfpipe.observe.session_commands import SessionCommands
from lfpipe.observe.session_reader import FollowingReader, Watch
from lfpipe.observe.state_text import Screen, print_state
from lfpipe.supervisor.rundir import find
from lfpipe.transport.status import Table

PERIOD_S = 0.25
NOTE_S = 5.0  # display time of the answer to a key


def run(name: str, once: bool, as_json: bool) -> None:
    """Shows the session of that name. as_json: for programs. Raises UserError if it does not run."""
    if as_json or once:
        stream(name, once, as_json)
    elif sys.stdout.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown"):  # dumb terminals cannot redraw
        session = find(name)  # at the start, a missing session is probably a mistake
        with contextlib.suppress(FileNotFoundError):
            Table(session.segment("status")).close()  # fails here for a table of another version
        screen(name)
    else:
        stream(name, once, as_json, 1.0)


def stream(name: str, once: bool, as_json: bool, period_s: float = PERIOD_S) -> None:
    """Prints samples on stdout until the session ends."""
    with Watch(find(name)) as watch:
        head = True
        while True:
            state = watch.read()
            if as_json:
                sys.stdout.write(json.dumps(state) + "\n")
            else:
                sys.stdout.write("" if head else "\n\n")
                print_state(state)
                head = False
            sys.stdout.flush()
            if once or not watch.living():
                return
            time.sleep(period_s)


def screen(name: str) -> None:
    """The terminal screen, until q or Ctrl-C."""
    from rich.console import Console
    from rich.live import Live

    console = Console()
    follower, remote, picture = FollowingReader(name), SessionCommands(name), Screen(name)
    hello: dict[str, Any] = {}
    revision, note_end = -1, 0.0
    with Keyboard() as keyboard, Live(console=console, screen=True, auto_refresh=False) as live:
        due = time.monotonic()
        while True:
            state = follower.read()
            if state is None:
                live.update(picture.waiting(), refresh=True)
                hello, revision = {}, -1
            else:
                if state["config_rev"] != revision:
                    hello, revision = _hello(remote), state["config_rev"]
                if time.monotonic() > note_end:
                    picture.note = ""
                live.update(picture.draw(state, hello, console.width), refresh=True)
            due = max(due + PERIOD_S, time.monotonic())
            while left_s := max(0.0, due - time.monotonic()):
                try:
                    key = keyboard.key(left_s)
                except KeyboardInterrupt:
                    key = "q"
                if key == "q":
                    follower.close()
                    return
                if key == "r" and follower.watch is not None:
                    follower.reset()
                    picture.reset()
                    picture.note, note_end = "counts reset", time.monotonic() + NOTE_S
                elif key:
                    picture.note, note_end = remote.press(key), time.monotonic() + NOTE_S


def _hello(remote: SessionCommands) -> dict[str, Any]:
    """The session's settings; empty if it does not answer."""
    try:
        return remote.ask({"cmd": "hello"}, 0.5)
    except UserError:
        return {}
