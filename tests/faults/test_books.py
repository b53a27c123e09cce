"""The account of every frame: drops and skipped frames explain every gap in the trace, also across pauses."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfpipe.transport.session import Session
from lfpipe.transport.status import Table
from tests.faults.soak import STAGES
from tests.world import World

pytestmark = pytest.mark.live


def test_gaps_in_the_trace_are_what_was_dropped_and_left_out(world: World, scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(world.run_dir))
    keys = ("camera.width_px=160", "camera.height_px=120", "camera.rate_hz=120", "render.rate_hz=60", "governor.quality=fixed")
    process = world.up(scene, *(f"--set={key}" for key in keys))
    world.pictures(10)
    table = Table(Session(world.name).segment("status"))

    def unseen(*kinds: str) -> int:
        return sum(int(table.rows[name][kind]) for name in STAGES for kind in kinds)

    @contextlib.contextmanager
    def at_rest() -> Iterator[tuple[int, int]]:
        """While capture is stopped, for less than a hang: the last frame shown, and the number not shown so far."""
        pid = int(table.rows["capture"]["pid"])
        os.kill(pid, signal.SIGSTOP)
        try:
            counts, since = (-1, -1), time.monotonic()
            end = since + 1.5
            while time.monotonic() < min(since + 0.3, end):
                now = world.lines()[-1]["source_seq"], unseen("drops", "left_out")
                if now != counts:
                    counts, since = now, time.monotonic()
                time.sleep(0.02)
            yield counts
        finally:
            os.kill(pid, signal.SIGCONT)

    with at_rest() as (first, before):
        pass
    for seconds in (0.4, 0.05, 0.01, 0.7):
        assert world.ask(cmd="pause")["ok"]
        time.sleep(seconds)
        assert world.ask(cmd="resume")["ok"]
        world.pictures(len(world.lines()) + 4)
    with at_rest() as (last, after):
        pictures = {line["source_seq"] for line in world.lines()}
    left_out = unseen("left_out")
    table.close()
    gaps = [seq for seq in range(first + 1, last + 1) if seq not in pictures]
    assert len(gaps) == after - before > 10 and left_out > 10
    process.send_signal(signal.SIGINT)
    assert process.wait(120) == 0
