"""The core works without lfpipe/extras: a copy without it runs sessions."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.world import World

ROOT = Path(__file__).parents[2]
FOLDERS = ("lfpipe", "tests", "tools", "docs", "examples", "profiling")
pytestmark = [pytest.mark.live, pytest.mark.timeout(1200)]


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkout without its extras, whose entry points stay installed."""
    copy = tmp_path_factory.mktemp("core")
    for name in FOLDERS:
        ignored = shutil.ignore_patterns("results")
        shutil.copytree(ROOT / name, copy / name, ignore=ignored)
    for path in (path for path in ROOT.iterdir() if path.is_file()):
        shutil.copy(path, copy)
    shutil.rmtree(copy / "lfpipe" / "extras")
    shutil.rmtree(copy / "tests" / "extras", ignore_errors=True)
    return copy


@pytest.fixture
def alone(world: World, core: Path) -> Iterator[World]:
    """Runs the copy."""
    world.env["PYTHONPATH"] = str(core)
    yield world


@pytest.mark.nightly
def test_core_without_extras_runs_sessions(alone: World, scene: Path, core: Path) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        alone.env.pop(name, None)
    where = subprocess.run(
        [sys.executable, "-c", "import lfpipe; print(lfpipe.__file__)"],
        env=alone.env,
        cwd=alone.root,
        capture_output=True,
        text=True,
        check=True,
    )
    assert str(core) in where.stdout
    process = alone.shows(scene)
    assert "render" in alone.done("monitor", "--session", alone.name, "--once").stdout
    assert "No such command" in alone.refused("ctl", "--session", alone.name, "share", "stop")
    alone.ctl("stop")
    assert process.wait(60) == 0
    alone.done("record", "walk", "--camera", "demo", "--duration", "0.5")
    alone.done("replay", "walk", "--scene", scene, "--out", "run")
    assert "3x3" in alone.done("scene", "info", scene).stdout
    alone.done("bench", "stability", "--quick", "--scene", scene)
