"""No code of the working directory ever runs: it may be a folder of somebody else's files."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.world import World, write_scene

CODE = "open({marker!r}, 'a').write(__name__ + chr(10))\n"

pytestmark = pytest.mark.nightly


@pytest.fixture
def trapped(world: World) -> Path:
    """A working directory with a file for each module of the standard library, which leaves a mark
    when it is imported. Returns the place of the mark.
    """
    marker = world.root / "marker"
    for name in sorted({*sys.stdlib_module_names, "numpy", "cv2", "zmq", "msgpack", "lfpipe"}):
        (world.root / f"{name}.py").write_text(CODE.format(marker=str(marker)))
    return marker


@pytest.mark.parametrize(
    "words",
    [
        ("up", "views", "--camera", "demo", "--display", "none", "--duration", "0.5"),
        ("record", "OUT", "--camera", "demo", "--duration", "0.5"),
        ("scene", "info", "demo:marbles"),
        ("doctor",),
        ("bench", "stability", "--quick", "--scene", "views"),
    ],
    ids=lambda words: words[0],
)
def test_no_code_of_the_working_directory_runs(
    world: World, trapped: Path, words: tuple[str, ...]
) -> None:
    write_scene(world.root / "views", 2, 2)  # not packed yet
    del world.env["PYTHONPATH"]  # the installed package alone, as for people
    lfpipe = Path(sys.executable).with_name("lfpipe")  # its folder comes first, not the working one
    ended = subprocess.run(
        [lfpipe, *words], cwd=world.root, env=world.env, capture_output=True, text=True, check=False
    )
    assert not trapped.exists(), trapped.read_text()
    assert ended.returncode == 0 or words[0] == "doctor", ended.stderr
