"""Names that are not UTF-8, printed and opened by the real program."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ODD = os.fsdecode(b"caf\xe9-\xff.avi")


def lfpipe(folder: Path, *words: str) -> subprocess.CompletedProcess[bytes]:
    own = {
        "XDG_CACHE_HOME": str(folder),
        "XDG_CONFIG_HOME": str(folder),
        "PYTHONUTF8": "1",
        "PYTHONPATH": str(Path(__file__).parents[1]),
    }
    env = {**os.environ, **own}
    return subprocess.run(
        [sys.executable, "-m", "lfpipe", *words],
        cwd=folder,
        env=env,
        capture_output=True,
        timeout=60,
    )


def test_odd_name_is_printed_as_its_bytes(tmp_path: Path) -> None:
    done = lfpipe(tmp_path, "config", "init", ODD)
    assert (done.returncode, done.stdout, done.stderr) == (0, os.fsencode(ODD) + b"\n", b"")


def test_odd_half_of_a_surrogate_pair_is_escaped(tmp_path: Path) -> None:
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
    tmp_path: Path, scene: Path, clip: Path, camera: str, display: str, code: int
) -> None:
    shutil.copytree(scene, tmp_path / "scene")
    if code == 0:
        shutil.copy(clip, tmp_path / ODD)
    words = ("up", "scene", "--camera", camera, "--display", display)
    done = lfpipe(tmp_path, *words, "--session", f"odd{os.getpid()}", "--duration", "1")
    assert (done.returncode, b"must be UTF-8" in done.stderr) == (code, code == 2), done.stderr


def test_odd_name_of_a_video_is_imported_but_not_made(tmp_path: Path, clip: Path) -> None:
    shutil.copy(clip, tmp_path / ODD)
    assert lfpipe(tmp_path, "sequence", "import", ODD, "out").returncode == 0
    done = lfpipe(tmp_path, "sequence", "export", "out", f"new-{ODD}.mkv")
    assert (done.returncode, b"must be UTF-8" in done.stderr) == (2, True)
