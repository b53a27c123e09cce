"""Paths that cannot be examined end no command with a traceback: locked folders, long names, no
working directory.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from lfpipe.host import files
from tests.support.processes import printed
from tests.support.world import World

LONG = "x" * 300  # longer than any file system allows
LFPIPE = [sys.executable, "-m", "lfpipe"]
UP = ("--display", "none", "--duration", "0.1")
COMMANDS = (
    ("up", "PATH", *UP),
    ("up", "--camera", "file:PATH", "SCENE", *UP),
    ("scene", "info", "PATH"),
    ("scene", "clean", "PATH"),
    ("kiosk", "install", "PATH"),
    ("ctl", "load", "PATH"),
    ("replay", "PATH"),
    ("sequence", "info", "PATH"),
)
EACH = """
import contextlib, io, json, sys
from lfpipe.cli import cli
from lfpipe.errors import UserError
for words in json.loads(sys.argv[1]):
    try:
        cli.main(words, standalone_mode=False)
    except UserError as error:
        assert "remedy: " in str(error), words
        print("refused")
    else:
        print(words)
"""


@pytest.fixture
def locked(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "locked"
    (folder / "lfpipe").mkdir(parents=True)
    (folder / "lfpipe" / "config.toml").touch()
    folder.chmod(0)
    yield folder
    folder.chmod(0o700)


def run(
    world: World, *command: str | Path, before: str = "", **env: str
) -> subprocess.CompletedProcess[str]:
    words = ["sh", "-c", f'{before} exec "$@"', "sh", *map(str, command)]
    known = world.env | {"LFPIPE_KIOSK_CODE": "leave2026"} | env
    done = subprocess.run(
        words, capture_output=True, text=True, cwd=world.root, env=known, timeout=100
    )
    assert "Traceback" not in done.stderr + done.stdout
    return done


def test_what_cannot_be_examined_is_neither_there_nor_missing(
    locked: Path, as_nobody: list[str]
) -> None:
    code = (
        "import sys; from lfpipe.host.files import *; from lfpipe.host.files import is_missing; p ="
        " sys.argv[1];"
    )
    code += "print(exists(p), is_file(p), is_dir(p), is_missing(p))"
    seen = printed(*as_nobody, sys.executable, "-c", code, locked / "in")
    assert seen.split() == ["False", "False", "False", "False"]
    assert not files.exists(LONG) and not files.is_missing(LONG)
    assert files.is_missing(locked.parent / "absent" / "in") and not files.is_missing(locked)


def test_a_path_that_cannot_be_examined_is_refused(
    world: World, scene: Path, locked: Path, as_nobody: list[str]
) -> None:
    names = {"PATH": "", "SCENE": str(scene)}
    commands = []
    for path in (locked / "in", Path(LONG)):
        names["PATH"] = str(path)
        commands += [
            [names.get(word, word).replace("PATH", str(path)) for word in words]
            for words in COMMANDS
        ]
    done = run(world, *as_nobody, sys.executable, "-c", EACH, json.dumps(commands))
    assert done.stdout.split("\n")[:-1] == ["refused"] * len(commands), done.stdout + done.stderr


def test_a_removed_working_directory_and_a_full_disk_are_named(world: World, scene: Path) -> None:
    for command in (("up", scene, *UP), ("ctl", "load", scene)):
        done = run(world, *LFPIPE, *command, before="mkdir gone && cd gone && rmdir ../gone &&")
        assert done.returncode == 2 and "working directory" in done.stderr
    done = run(world, *LFPIPE, "scene", "info", scene, before="exec > /dev/full;")
    assert done.returncode == 2 and os.strerror(28) in done.stderr


def test_a_limit_on_memory_is_kept(world: World, scene: Path, as_nobody: list[str]) -> None:
    """A user's own limit (`ulimit -d`) is below what the packer would set."""
    done = run(world, *as_nobody, *LFPIPE, "scene", "info", scene, before="ulimit -d 800000;")
    assert done.returncode == 0, done.stderr
    done = run(world, *as_nobody, *LFPIPE, "scene", "info", scene, before="ulimit -d 100000;")
    assert done.returncode == 2 and "memory" in done.stderr
