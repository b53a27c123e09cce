"""The render stage in a running session."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from lfpipe.eyes import MAX_HORIZON_S
from tests.world import World

pytestmark = pytest.mark.live


def _alone(world: World, since_ns: int) -> list[dict[str, Any]]:
    return [line for line in world.lines() if not line["face"] and line["t_composed_ns"] > since_ns]


def test_records_of_a_tracker_that_hangs_are_no_viewer(world: World, scene: Path) -> None:
    """Found after SIGKILL of track: "eyes predicted ahead p95 2588 ms"."""
    world.up(scene)
    world.wait_for(lambda: any(line["face"] for line in world.lines()), "a face")
    pid = world.kill("track", signal.SIGSTOP)
    stopped_ns = time.monotonic_ns()
    try:
        lines = world.wait_for(lambda: _alone(world, stopped_ns), "picture for nobody", 5)
    finally:
        os.kill(pid, signal.SIGCONT)
    assert lines[0]["t_composed_ns"] - lines[0]["t_sensor_ns"] < 0.7e9
    assert world.monitor()["horizon"]["max_ms"] <= 1.02e3 * MAX_HORIZON_S


def test_a_slow_camera_is_no_dead_tracker(world: World, scene: Path, clip: Path) -> None:
    """One frame in 800 ms is older than a dead tracker's last one when the next comes, and still shows where the viewer is."""
    world.up(scene, camera=f"file:{clip}?pace=1.25&loop=1")
    world.wait_for(lambda: len({line["source_seq"] for line in world.lines() if line["face"]}) > 4, "five faces")
    lines = world.lines()
    known = next(line["source_seq"] for line in lines if line["face"]) + 2  # two frames tell how slow the camera is
    assert all(line["face"] for line in lines if line["source_seq"] >= known)
