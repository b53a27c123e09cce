"""Sessions that show a light field while it is captured: from a clip, and from a program."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import lfpipe
from tests.live import made
from tests.render import rendered
from tests.support.films import write_film
from tests.support.world import World

NEW_STAGES = ("views", "disparity")
PROGRAM = """
import sys, time
import numpy as np, lfpipe
name, disparity = sys.argv[1], sys.argv[2:] == ["disparity"]
views = np.random.default_rng(1).integers(0, 256, (1, 2, 96, 128, 3), np.uint8)
maps = np.zeros((1, 2, 48, 64)) if disparity else None
with lfpipe.LiveScene(name, rows=1, cols=2, size_px=(128, 96)) as scene:
    print("ready", flush=True)
    while True:
        scene.write(views, maps)
        time.sleep(1 / 30)
"""


def started(world: World, *words: str) -> "subprocess.Popen[str]":
    """PROGRAM, which draws the scene of the world's name."""
    command = [sys.executable, "-c", PROGRAM, world.name, *words]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=world.env)
    assert program.stdout is not None and program.stdout.readline() == "ready\n"
    return program


def remove_left(world: World, name: str) -> None:
    """Removes what a program that was killed has left, as the next one of its name does."""
    with world.entered():
        lfpipe.LiveScene(name, rows=1, cols=2, size_px=(64, 48)).close()


@contextlib.contextmanager
def drawing(world: World, *words: str) -> Iterator[str]:
    """The name of a scene that a program draws meanwhile."""
    program = started(world, *words)
    try:
        yield f"live:ring:{world.name}"
    finally:
        program.kill()
        program.wait()
        remove_left(world, world.name)


@pytest.fixture
def views(tmp_path: Path) -> Path:
    """A clip of a still scene, two views side by side."""
    frame = made.frame_of(rendered.field(1, 2, 240, 320, scale=2.0))
    return write_film(tmp_path / "views.avi", [frame] * 30)


def test_session_shows_views_and_their_disparity(world: World, views: Path) -> None:
    world.shows(Path(f"live:file:{views}"), pictures=60)
    lines = world.more_pictures(60)
    assert {line["method"] for line in lines} == {"warp2"}
    lines = [line for line in lines if "t_views_ns" in line]  # since the first frame of the scene
    assert np.mean([line["own_disparity"] for line in lines]) > 0.5
    assert all(line["t_views_ns"] < line["t_presented_ns"] for line in lines)
    state = world.monitor()
    assert {*NEW_STAGES, "render"} <= set(state["stages"])
    assert state["stages"]["render"]["metrics"]["own_disparity"] > 30


@pytest.mark.live
def test_session_keeps_the_last_picture_of_a_program_and_finds_it_again(world: World) -> None:
    name = world.name
    program = started(world, "disparity")
    session = world.shows(Path(f"live:ring:{name}"), pictures=30)
    program.kill()
    program.wait()
    world.more_pictures(60)  # the viewer still moves in front of the last frame
    world.wait_for(lambda: world.monitor()["stages"]["views"]["state"] == "READY", "the loss")
    program = started(world, "disparity")
    before = world.monitor()["stages"]["views"]["count"]
    world.wait_for(lambda: world.monitor()["stages"]["views"]["count"] > before + 20, "its return")
    program.terminate()
    program.wait()
    remove_left(world, name)
    world.ctl("stop")
    said = world.ended(session)
    assert "its program has ended; camera lost, trying again" in said
    assert f"ring:{name} is back after" in said


@pytest.mark.live
def test_example_draws_a_live_scene(world: World) -> None:
    example = Path(__file__).parents[2] / "examples" / "live_scene.py"
    command = [sys.executable, str(example), "eyes"]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=world.env)
    try:
        assert program.stdout is not None and "lfpipe up" in program.stdout.readline()
        world.shows(Path("live:ring:ball"), pictures=30)
        world.wait_for(
            lambda: world.monitor()["stages"]["render"]["metrics"]["own_disparity"] > 30,
            "pictures of its frames",
        )
    finally:
        program.terminate()
        program.wait()
        remove_left(world, "ball")


@pytest.mark.nightly
def test_viewer_of_a_live_scene_is_recorded_and_replayed(world: World, views: Path) -> None:
    out = world.root / "rec"
    world.shows(Path(f"live:file:{views}"), camera="demo")
    world.ctl("record", "start", out)
    world.wait_for(lambda: (out / "frames.jsonl").exists() and lines_of(out) > 30, "frames")
    world.ctl("record", "stop")
    world.wait_for(lambda: '"complete": true' in (out / "manifest.json").read_text(), "manifest")
    world.ctl("stop")
    assert f"{lines_of(out)} frames" in world.done("sequence", "check", out).stdout
    world.done("replay", out, "--out", world.root / "first")
    assert "matches" in world.done("replay", out, "--expect", world.root / "first").stdout


def lines_of(recording: Path) -> int:
    """The frames that a recording has so far."""
    return (recording / "frames.jsonl").read_text().count("\n")
