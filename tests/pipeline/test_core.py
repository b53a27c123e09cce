"""The core works without lfpipe/extras: a copy without it runs sessions and passes its tests."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.world import World

ROOT = Path(__file__).parents[2]
FOLDERS = ("lfpipe", "tests", "tools", "docs", "examples", "profiling")
# of every package of the core a file of tests that imports it; the points for plug-ins; what asks
# whether there are extras
SAMPLE = """
    api/test_api.py::test_import_lfpipe_loads_nothing_else bench/test_runner.py
    cli/test_help.py cli/test_plugged.py contracts
    config/test_config.py::test_the_file_at_the_top_and_the_pages_of_keys_and_commands_are_current
    docs/test_commands.py docs/test_figures.py files/test_writers.py host/test_shared_memory.py
    live/test_field.py monitor/test_monitor.py notices pipeline/test_held.py render/test_notices.py
    replay/test_recorder_faults.py scene/test_description.py sequence/test_views.py
    supervisor/test_session_state.py supervisor/test_wire_format.py
    test_plugins.py::test_plugin_engine_or_filter_that_fails_is_named test_structure.py
    track/test_eye_tracker.py transport/test_packet_ring.py
"""
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


def test_core_without_extras_reports_what_is_missing(alone: World) -> None:
    assert "sweep" not in alone.done("--help").stdout
    assert "No such command 'sweep'" in alone.refused("sweep", "plan.toml")
    assert "--share" in alone.refused("up", "--demo", "--share", "lsl")
    told = " ".join(alone.run("doctor").stdout.split())
    assert "command sweep, from lfpipe" in told and "stage share, from lfpipe" in told
    assert "No module named 'lfpipe.extras'" in told


def test_core_without_extras_passes_a_sample_of_its_tests(core: Path) -> None:
    sample = [f"tests/{name}" for name in SAMPLE.split()]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", *sample],
        env={**os.environ, "PYTHONPATH": str(core)},
        cwd=core,
        capture_output=True,
        text=True,
    )
    print(done.stdout[-800:], done.stderr)
    assert done.returncode == 0, done.stdout[-4000:]
