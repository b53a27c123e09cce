"""`lfpipe scene clean` beside a session."""

import os
import signal
from pathlib import Path

import pytest

from tests.world import World

pytestmark = pytest.mark.live


def test_clean_takes_nothing_from_a_running_session(world: World, scene: Path) -> None:
    world.up(scene, "--set", "render.clock=camera")
    world.pictures(5)
    cleaned = world.run("scene", "clean", "--all")
    assert cleaned.returncode == 0 and "in use, kept" in cleaned.stdout and "removed 0 packs" in cleaned.stdout
    changed = world.run("ctl", "--session", world.name, "set", "render.anaglyph=grey")
    assert changed.returncode == 0, changed.stderr
    os.kill(world.monitor()["stages"]["render"]["pid"], signal.SIGKILL)
    assert "in use, kept" in world.run("scene", "clean", "--all").stdout  # while no render has it open
    world.pictures(len(world.lines()) + 5)
    stopped = world.run("ctl", "--session", world.name, "stop")
    assert stopped.returncode == 0, stopped.stderr
    world.wait_for(lambda: not world.left(), "end of the session")
    assert "removed 1 packs" in world.run("scene", "clean", "--all").stdout
