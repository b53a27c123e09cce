"""What a person types on the command line: typos have a remedy, tables fit narrow terminals, Tab
completes.
"""

import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from click.testing import CliRunner

from lfpipe.__main__ import main
from lfpipe.cli import cli, terminal
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


def test_cli_ends_at_ctrl_c_while_it_is_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted(ModuleType):
        def __getattr__(self, name: str) -> object:
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "lfpipe.cli", Interrupted("lfpipe.cli"))
    with pytest.raises(SystemExit, match="130"):
        main()


def test_cli_tables_fit_80_columns(live: World, scene: Path) -> None:
    live.env["COLUMNS"] = "80"
    scenes = (("scene", "list"), ("scene", "info", scene), ("scene", "plan", scene))
    for words in (("ctl", "status"), ("monitor", "--once"), *scenes):
        done = live.done(
            *words, *(("--session", live.name) if words[0] in ("ctl", "monitor") else ())
        )
        # a path stays whole
        wide = [line for line in done.stdout.splitlines() if len(line) > 80 and " " in line.strip()]
        assert not wide or all("/" in line for line in wide), wide


def test_progress_in_a_log_is_a_line_and_no_bar(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for quiet_s, said in ((60.0, ""), (-1.0, "rendering the demo scene: 0 of 81\n")):
        monkeypatch.setattr(terminal, "QUIET_S", quiet_s)
        with terminal.progress() as report:
            for done in range(81):
                report("rendering the demo scene", done, 81)
        assert capfd.readouterr().err == said


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_has_a_script_for_every_shell(shell: str) -> None:
    assert "_LFPIPE_COMPLETE" in CliRunner().invoke(cli, ["completion", shell]).output


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
