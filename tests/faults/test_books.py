"""The account of every frame: drops and skipped frames explain every gap in the trace, also across pauses."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import pytest

from lfpipe.transport import control
from lfpipe.transport.session import Session
from lfpipe.transport.status import Table
from tests.faults.session import WatchedSession
from tests.world import World

pytestmark = pytest.mark.live

STAGES = ("capture", "track", "render")


def ask(world: World, **message: Any) -> None:
    assert control.request(next(world.run_dir.glob("lfpipe-*")), message, 20)["ok"]


def pauses(world: World) -> None:
    for seconds in (0.4, 0.05, 0.01, 0.7):
        ask(world, cmd="pause")
        time.sleep(seconds)
        ask(world, cmd="resume")
        world.pictures(len(world.lines()) + 4)


def test_frames_of_a_pause_are_counted_by_the_stage_that_left_them_out(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(world.run_dir))
    session = WatchedSession(world, size_px=(160, 120), rate_hz=60.0)
    pauses(world)
    books = session.books()
    assert not any(books.errors().values()), books
    assert sum(int(session.watcher.table.rows[name]["left_out"]) for name in STAGES) > 20
    session.end()


@pytest.mark.parametrize(("clock", "rate_hz"), [("camera", 60), ("display", 30), ("display", 120)])
def test_gaps_in_the_trace_are_what_was_dropped_and_left_out(
    world: World, scene: Any, monkeypatch: pytest.MonkeyPatch, clock: str, rate_hz: int
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(world.run_dir))
    keys = ("camera.width_px=160", "camera.height_px=120", f"camera.rate_hz={rate_hz}", f"render.clock={clock}")
    process = world.up(scene, *(f"--set={key}" for key in (*keys, "render.rate_hz=60", "governor.quality=fixed")))
    world.pictures(10)
    table = Table(Session(world.name).segment("status"))

    @contextlib.contextmanager
    def at_rest() -> Iterator[tuple[int, int]]:
        """While capture is paused: the last frame shown, and the number not shown so far."""
        pid = int(table.rows["capture"]["pid"])
        os.kill(pid, signal.SIGSTOP)
        try:
            found, since = (-1, -1), time.monotonic()
            end = since + 1.5
            while time.monotonic() < min(since + 0.3, end):
                last = world.lines()[-1]["source_seq"]
                now = last, sum(int(table.rows[name][what]) for name in STAGES for what in ("drops", "left_out"))
                if now != found:
                    found, since = now, time.monotonic()
                time.sleep(0.02)
            yield found
        finally:
            os.kill(pid, signal.SIGCONT)

    with at_rest() as (first, before):
        pass
    pauses(world)
    with at_rest() as (last, after):
        shown = {line["source_seq"] for line in world.lines()}
    table.close()
    gaps = [seq for seq in range(first + 1, last + 1) if seq not in shown]
    assert len(gaps) == after - before > 10
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
