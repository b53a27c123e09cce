"""What a person types on the command line: typos have a remedy, tables fit narrow terminals, Tab
completes.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lfpipe import cli
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
def test_cli_names_a_slip_with_its_remedy(
    words: tuple[str, ...],
    remedy: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    for name in ("LFPIPE_RUN_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["lfpipe", *words])
    with pytest.raises(SystemExit, match="2"):
        cli.run()
    assert remedy in capfd.readouterr().err and not list(tmp_path.iterdir())


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
