"""A package of one's own adds a layout, an engine, a filter and a display; errors name a broken
one.
"""

import os
import shutil
import sys
from pathlib import Path

import pytest

from tests.scene import made
from tests.support.processes import printed
from tests.support.world import World, write_package

pytestmark = pytest.mark.live
EXAMPLE = Path(__file__).parents[2] / "examples" / "lfpipe-example"
BROKEN = """
[lfpipe.engines]
broken = nowhere:x
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the example and a broken package, built and installed."""
    if (uv := shutil.which("uv")) is None:
        pytest.skip("uv is not installed")
    folder = tmp_path_factory.mktemp("plugins")
    copy = tmp_path_factory.mktemp("source") / "example"
    shutil.copytree(EXAMPLE, copy)
    command = [
        uv,
        "pip",
        "install",
        "--offline",
        "--no-deps",
        "--no-build-isolation",
        "--python",
        sys.executable,
    ]
    printed(*command, "--target", folder, copy)
    write_package(folder, BROKEN, "broken", "2.0")
    return folder


def test_plugin_parts_work_and_a_broken_one_is_named(
    world: World, installed: Path, clip: Path
) -> None:
    world.env["PYTHONPATH"] += os.pathsep + str(installed)
    scene = world.root / "scene"
    for name, view in zip(("left", "middle", "right"), made.wall(1, 3, 48, 64)[0], strict=True):
        made.write(scene / f"{name}.png", view)
    info = world.run("scene", "info", scene, "--json")
    assert '"trio"' in info.stdout, info.stderr
    sets = ("--set", "track.engine=centre", "--set", "track.filter=newest")
    count = world.root / "count"
    camera = ("--camera", f"file:{clip}?loop=0&pace=max")
    traced = ("--trace", world.trace)
    world.done(
        "up", scene, *camera, *traced, "--display", f"count:{count}", *sets, "--duration", "3"
    )
    assert int(count.read_text()) > 0
    line = world.lines()[-1]
    assert line["eyes_raw"] == {"left": [352.0, 240.0], "right": [288.0, 240.0]}  # of CentreEngine
    assert "broken of broken 2.0 (lfpipe.engines): ModuleNotFoundError" in world.refused(
        "up", scene, *camera, "--display", "none", "--set", "track.engine=broken"
    )


NEVER = """
import os
import sys

from lfpipe.render.display.display import Pointer

class Engine:
    name, model, rotated_deg = "never", "none", 0
    examine = reset = close = lambda *_: None

    def __init__(self, track):
        pass

    def detect(self, image):
        sys.exit(0)

class Crash(Engine):
    def detect(self, image):
        os._exit(0)

class Screen:
    events = presented = notices = lambda *_: []
    overlay = title = width_mm = close = lambda *_: None
    nominal_hz = lambda *_: 60.0
    vblank_source, knows_rows, pointer = "test", True, Pointer()

    def __init__(self, *_):
        pass

    def show(self, *_):
        return None

"""
NEVER_ENTRIES = """
[lfpipe.engines]
engine = never:Engine
crash = never:Crash
[lfpipe.displays]
screen = never:Screen
"""


def install_never(world: World) -> None:
    """Installs the package of NEVER for the commands of world."""
    folder = world.root / "packages"
    write_package(folder, NEVER_ENTRIES, "never")
    (folder / "never.py").write_text(NEVER)
    world.env["PYTHONPATH"] += os.pathsep + str(folder)


def test_plugin_engine_that_ends_its_process_ends_the_session(world: World, scene: Path) -> None:
    install_never(world)
    words = ("up", scene, "--camera", "demo", "--display", "none", "--set", "track.engine=crash")
    done = world.run(*words, "--duration", "2")
    assert done.returncode == 1, done.stderr
    assert "track failed before its first eyes: it never worked" in done.stderr
