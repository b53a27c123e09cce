"""What a person types on the command line: typos have a remedy, tables fit narrow terminals, Tab
completes.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.world import World


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (("up", "--demo", "--set", "render.metod=warp"), "did you mean 'render.method'?"),
        (("up", "--demo", "--set", "render.rate_hz=9999"), "lfpipe config show"),
        (("up", "--demo", "--set", "track.filter=oneeuro"), "one-euro"),
        (("up", "--demo", "--camera", "fiel:a.mp4"), "file:PATH"),
        (("replay", "walk", "--pace", "fast"), "step, max, recorded or a rate"),
        (("up",), "--demo"),
        (("up", "--durtion", "3"), "--duration"),
        (("up", "--demo", "--duration", "nan"), "nan is not a finite number"),
    ],
)
@pytest.mark.everyday
def test_cli_names_a_slip_with_its_remedy(
    words: tuple[str, ...], remedy: str, world: World
) -> None:
    assert remedy in world.refused(*words)
    assert not Path(world.root, "lfpipe-demo").exists() and not world.left()


def test_cli_into_a_closed_pipe_ends_quietly(world: World) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer) as closed:
        done = subprocess.run(
            [sys.executable, "-m", "lfpipe", "config", "show"],
            stdout=closed,
            stderr=subprocess.PIPE,
            env=world.env,
        )
    assert (done.returncode, done.stderr) == (141, b"")
