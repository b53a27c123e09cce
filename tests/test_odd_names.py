"""Names that are not UTF-8, printed and opened by the real program."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.world import World

pytestmark = pytest.mark.everyday
ODD = os.fsdecode(b"caf\xe9-\xff.avi")


def lfpipe(world: World, *words: str) -> subprocess.CompletedProcess[bytes]:
    ended: subprocess.CompletedProcess[Any] = world.run(
        *words, text=False, env=world.env | {"PYTHONUTF8": "1"}
    )
    return ended  # its output is bytes


def test_odd_name_is_printed_as_its_bytes(world: World) -> None:
    done = lfpipe(world, "config", "init", ODD)
    assert (done.returncode, done.stdout, done.stderr) == (0, os.fsencode(ODD) + b"\n", b"")


def test_odd_half_of_a_surrogate_pair_is_escaped() -> None:
    script = (
        "import sys; sys.argv = ['lfpipe', 'x']; import lfpipe.cli as c; c.cli = lambda **_:"
        " print('a\\ud800b'); c.run()"
    )
    done = subprocess.run(
        [sys.executable, "-X", "utf8", "-c", script], capture_output=True, timeout=60
    )
    assert done.stdout == b"a\\ud800b\n"


@pytest.mark.parametrize(
    ("camera", "display", "code"), [(f"file:{ODD}", "none", 0), ("demo", f"file:{ODD}", 2)]
)
def test_odd_name_of_a_video_is_played_but_not_made(
    world: World, scene: Path, clip: Path, camera: str, display: str, code: int
) -> None:
    if code == 0:
        shutil.copy(clip, world.root / ODD)
    words = ("up", str(scene), "--camera", camera, "--display", display)
    done = lfpipe(world, *words, "--session", world.name, "--duration", "1")
    assert (done.returncode, b"must be UTF-8" in done.stderr) == (code, code == 2), done.stderr


def test_odd_name_of_a_video_is_imported(world: World, clip: Path) -> None:
    shutil.copy(clip, world.root / ODD)
    assert lfpipe(world, "sequence", "import", ODD, "out").returncode == 0
