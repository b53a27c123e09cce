"""Every program of examples/ runs as its first line says."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from tests.world import World

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        ("view.py SCENE view.png", "3x3 views"),
        ("from_array.py views.npy", "(96, 128, 3)"),
        ("eyes.py VIDEO", " mm"),
        ("session.py SCENE demo", "p50"),
        ("compare_filters.py SEQ SCENE", "mean 60 faces"),
        ("record_and_replay.sh SCENE demo", "matches reference"),
    ],
)
def test_a_program_runs(world: World, scene: Path, clip: Path, words: str, printed: str) -> None:
    places = {"SCENE": str(scene), "VIDEO": str(clip), "SEQ": str(world.root / "walk")}
    if "SEQ" in words:
        from lfpipe.sequence.edit import from_video

        from_video(clip, world.root / "walk")
    command = world.root / "bin" / "lfpipe"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m lfpipe "$@"\n')
    command.chmod(command.stat().st_mode | stat.S_IXUSR)
    env = world.env | {"PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}"}
    program, *arguments = words.split()
    start = [sys.executable] if program.endswith(".py") else []
    given = [places.get(word, word) for word in arguments]
    done = subprocess.run([*start, EXAMPLES / program, *given], capture_output=True, text=True, cwd=world.root, env=env)
    assert done.returncode == 0 and printed in done.stdout, done.stdout + done.stderr


def test_every_program_is_run() -> None:
    run = {row[0].split()[0] for row in test_a_program_runs.pytestmark[0].args[1]}  # type: ignore[attr-defined]
    assert run == {path.name for path in EXAMPLES.iterdir() if path.is_file()}
