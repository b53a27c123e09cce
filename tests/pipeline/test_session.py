"""Whole sessions: real processes, real shared memory, real pictures; only the camera is a file."""

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.support.world import World, stays, write_scene

CAMERA = ("--set", "render.clock=camera")
NEAREST = ("--set", "render.method=nearest", "--set", "render.alpha_px=12")


@pytest.mark.everyday
def test_session_shows_every_frame_of_a_file_and_ends(
    world: World, scene: Path, clip: Path
) -> None:
    process = world.up(scene, *CAMERA, *NEAREST, camera=f"file:{clip}?loop=0&pace=max")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    lines = world.lines()
    assert [line["source_seq"] for line in lines] == list(range(60))
    assert [line["seq"] for line in lines] == list(range(60))
    assert sum(line["face"] for line in lines) >= 57
    for line in lines:
        stamps = [
            line[f"t_{name}_ns"] for name in ("sensor", "read", "tracked", "composed", "presented")
        ]
        assert stamps == sorted(stamps) and all(type(stamp) is int for stamp in stamps)
        assert line["epoch"] == 0 and line["method"] == "nearest"
        if line["face"]:
            (left, _), (right, _) = line["eyes_used"]["left"], line["eyes_used"]["right"]
            assert left > right, "the viewer's left eye is at larger x"
            assert line["view"]["left"][1] <= line["view"]["right"][1], (
                "the left eye looks from the camera further left"
            )
            assert line["view"]["left"][0] == line["view"]["right"][0]
    assert str(world.trace) in out and not world.left()


@pytest.mark.everyday
def test_monitor_and_ctl_change_the_next_picture(world: World, scene: Path, tmp_path: Path) -> None:
    world.shows(scene, *CAMERA, *NEAREST, pictures=10)

    def at_rate() -> dict[str, Any] | None:
        """The figures, unless render is just opening the scene again, with its disparity."""
        state = world.monitor()
        ready = {stage["state"] for stage in state["stages"].values()} == {"RUNNING"}
        return state if ready and state["camera_fps"] > 20 else None

    state = world.wait_for(at_rate, "camera rate")
    assert state["session"] == world.name and set(state["stages"]) == {"capture", "track", "render"}
    for stage in state["stages"].values():
        assert stage["restarts"] == 0 and 0 < stage["fps"] < 90
    assert 0 < state["end_to_end"]["p50_ms"] <= state["end_to_end"]["max_ms"]

    def ctl(*words: str) -> Any:
        return json.loads(world.ctl("--json", *words))

    assert ctl("set", "render.swap_eyes=true")["applied"] is True
    line = world.more_pictures(2)[-1]
    assert line["view"]["left"][1] >= line["view"]["right"][1]
    assert world.ask(cmd="recentre")["ok"]
    assert ctl("pause")["applied"] is True
    count = len(world.lines())
    stays(lambda: len(world.lines()) == count, 0.5, "the pause")
    assert world.ask(cmd="resume")["ok"]
    world.pictures(count + 5)
    ctl("load", str(write_scene(tmp_path / "other", 1, 5)))
    assert world.more_pictures(5)[-1]["view"]["left"][0] == 0
    assert "nowhere" in world.refused("ctl", "--session", world.name, "load", "nowhere")
    world.more_pictures(5)
    assert world.ask(cmd="stop")["ok"]
    world.wait_for(lambda: not world.left(), "clean end")


@pytest.mark.everyday
def test_stages_that_are_killed_or_hang_come_back(world: World, scene: Path) -> None:
    process = world.shows(scene, *CAMERA, start_new_session=True, pictures=10)
    for number, stage in enumerate(("capture", "track", "render"), 1):
        before = world.monitor()
        world.kill(stage, signal.SIGSTOP if stage == "track" else signal.SIGKILL)
        world.wait_for(
            lambda stage=stage: world.monitor()["stages"][stage]["restarts"] == 1, "restart"
        )
        world.wait_for(
            lambda stage=stage: world.monitor()["stages"][stage]["state"] == "RUNNING",
            "restarted stage",
        )
        lines = world.more_pictures(5)
        after = world.monitor()
        assert after["stages"][stage]["pid"] != before["stages"][stage]["pid"]
        assert [row["restarts"] for row in after["stages"].values()].count(0) == 3 - number
        numbers = [line["seq"] for line in lines]
        assert numbers == sorted(set(numbers)), "the trace and its count survive"
        # a picture is counted before its line is written: that of the kill may have none
        assert numbers[-1] - len(lines) < (stage == "render"), numbers
        assert lines[-1]["epoch"] == 1, "capture is another one"
    pids = [row["pid"] for row in after["stages"].values()]
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    assert "track: no beat for" in world.ended(process) and not any(
        Path(f"/proc/{pid}").exists() for pid in pids
    )
