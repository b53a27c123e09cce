"""Sessions that a program starts: changed, loaded, stopped; nothing is left, however the program
ends.
"""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import lfpipe
from tests.support.refusal import refusal
from tests.support.world import World

pytestmark = pytest.mark.live
QUICK = {"render.method": "nearest", "render.alpha_px": 12}


@pytest.fixture
def home(world: World, monkeypatch: pytest.MonkeyPatch) -> Iterator[World]:
    for key, value in world.env.items():
        monkeypatch.setenv(key, value)
    for key in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(key, raising=False)
    yield world


def test_session_in_a_thread_is_changed_loaded_and_stopped(home: World, scene: Path) -> None:
    failures: list[BaseException] = []

    def run() -> None:
        try:
            trace = home.root / "t.jsonl"
            with lfpipe.Session(scene, camera="demo", trace=trace, settings=QUICK) as session:
                home.wait_for(lambda: trace.exists() and trace.stat().st_size, "line of the trace")
                # it is STARTING for a moment once more, when disparity comes to the views
                home.wait_for(
                    lambda: session.status()["stages"]["render"]["state"] == "RUNNING",
                    "a running render",
                )
                assert session.frame().picture.shape[2] == 3
                assert next(eyes for eyes in session.stream() if eyes is not None).head is not None
                session.set({"render.method": "blend"})
                with lfpipe.attach(session.name) as other:
                    assert other.ask({"cmd": "hello"})["config"]["render"]["method"] == "blend"
                    other.load(np.full((2, 2, 32, 40, 3), 90, np.uint8))
                    refusal(other.set, {"render.method": "wrap"})
                    taken = refusal(lfpipe.Session, scene, camera="demo", name=session.name)
                    assert "already running" in taken.message and taken.remedy == (
                        f"use another name, or end it: `lfpipe ctl --session {session.name} stop`"
                    )
                    session.stop()
                    assert other.wait(60) and session.wait()
                for ended in (session, other):
                    for call in (ended.status, ended.eyes, lambda ended=ended: ended.set({})):
                        with pytest.raises(lfpipe.UserError, match=r"has ended|closed"):
                            call()
                assert "has ended: it was stopped" in str(refusal(session.eyes))
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(240)
    assert not failures and not thread.is_alive(), failures
    assert home.segments() == []


def test_session_that_is_killed_says_how_it_ended(home: World, scene: Path) -> None:
    with lfpipe.Session(scene, camera="demo", settings=QUICK) as session:
        os.kill(session.status()["stages"]["render"]["pid"], 0)
        os.kill(session._process.pid, signal.SIGKILL)
        with pytest.raises(lfpipe.UserError, match="has ended"):
            while True:
                session.status()
        refusal(session.wait)


def test_session_of_a_killed_interpreter_leaves_nothing(home: World, scene: Path) -> None:
    code = f"""
import lfpipe, time
with lfpipe.Session({str(scene)!r}, camera="demo", name="killed") as session:
    print("runs", flush=True)
    time.sleep(600)
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, env=home.env, cwd=home.root
    )
    assert process.stdout is not None and process.stdout.readline() == b"runs\n"
    assert home.segments()
    process.kill()
    process.communicate(timeout=60)
    home.wait_for(lambda: not home.segments() and not list(home.run_dir.glob("*/ctl")), "clean end")
