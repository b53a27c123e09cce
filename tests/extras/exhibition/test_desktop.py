"""`lfpipe desktop`: its files are valid, name this program and go again."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.world import World


@pytest.mark.nightly
def test_desktop_entries_are_valid_and_go_again(world: World) -> None:
    data = world.root / "data"
    world.env["XDG_DATA_HOME"] = str(data)
    for _ in range(2):  # its own files are replaced
        done = world.done("desktop", "install")
    entry, opens, icon = map(Path, done.stdout.splitlines())
    assert f'Exec="{sys.executable}" -P -m lfpipe.extras.exhibition\n' in entry.read_text()
    assert " -P -m lfpipe.extras.exhibition up %f\n" in opens.read_text() and icon.suffix == ".svg"
    if shutil.which("desktop-file-validate"):
        subprocess.run(["desktop-file-validate", entry, opens], check=True)
    removed = world.run("desktop", "remove").stdout.splitlines()
    assert removed == [str(entry), str(opens), str(icon)]
    assert not [path for path in data.rglob("*") if path.is_file()]
