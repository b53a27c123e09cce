"""A session does little while nothing changes, and reacts at once when something does."""

import itertools
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.support.films import write_film
from tests.support.world import World
from tests.support.xvfb_screen import Screen, needs_xdotool


def rests(world: World) -> bool:
    return bool(world.monitor()["stages"]["render"]["metrics"]["resting"])


def idle(world: World) -> bool:
    return bool(world.ask(cmd="hello")["options"]["idle"])


@pytest.mark.live
@needs_xdotool
def test_window_rests_while_the_mouse_stands_still(
    world: World, scene: Path, screen: Screen
) -> None:
    world.env["DISPLAY"] = screen.name
    world.start("up", scene, "--camera", "mouse", "--session", world.name)
    world.wait_for(lambda: world.left() and idle(world), "an idle session")
    before = world.monitor()["stages"]["render"]
    assert rests(world)
    world.xdotool("mousemove", 40, 40)
    world.xdotool("mousemove", 80, 60)  # wherever the pointer was, it has moved now
    moved = world.wait_for(
        lambda: (now := world.monitor()["stages"]["render"])["count"] > before["count"] and now,
        "a picture",
    )
    assert moved["missed"] == before["missed"]

    def works() -> bool:
        """While the mouse moves: the supervisor looks once a second."""
        world.xdotool("mousemove", *next(places))
        return not idle(world)

    places = itertools.cycle([(40, 40), (80, 60)])
    world.wait_for(works, "a session at work")


@pytest.mark.live
def test_camera_is_read_less_often_while_nobody_looks(
    world: World, scene: Path, tmp_path: Path
) -> None:
    grey = np.full((480, 640, 3), 128, np.uint8)
    blank = write_film(tmp_path / "blank.avi", [grey] * 60)
    world.start(
        "up", scene, "--camera", f"file:{blank}", "--display", "none", "--session", world.name
    )
    world.wait_for(lambda: world.left() and idle(world), "an idle session")
    before = world.monitor()["stages"]
    capture = psutil.Process(before["capture"]["pid"])
    slept = capture.num_ctx_switches().voluntary
    after = world.wait_for(
        lambda: (
            (now := world.monitor()["stages"])["track"]["count"] > before["track"]["count"] + 9
            and now
        ),
        "frames",
    )
    slept = capture.num_ctx_switches().voluntary - slept
    frames = after["capture"]["count"] - before["capture"]["count"]
    left_out = after["capture"]["left_out"] - before["capture"]["left_out"]
    assert left_out > frames, (frames, left_out)  # 2.75 times, if none is lost
    assert slept < 2 * frames, (frames, slept)  # a frame that is left out is not waited for


@pytest.mark.live
def test_recording_stands_still_while_paused(world: World, scene: Path) -> None:
    world.shows(scene)
    world.ctl("pause")
    before = world.lines()[-1]["source_seq"]
    dropped = world.monitor()["stages"]["capture"]["dropped"]
    until_s = world.monitor()["uptime_s"] + 1.5  # 45 frames
    world.wait_for(lambda: world.monitor()["uptime_s"] > until_s, "the pause")
    assert world.monitor()["stages"]["capture"]["dropped"] == dropped
    world.ctl("resume")
    after = next(line for line in world.more_pictures(5) if line["source_seq"] > before)
    assert after["source_seq"] < before + 15, (before, after["source_seq"])
