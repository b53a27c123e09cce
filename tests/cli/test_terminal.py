"""All that commands print goes through `lfpipe.cli.terminal`."""

import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from lfpipe.cli import cli, terminal


@pytest.mark.parametrize("out", [terminal.print_result, terminal.say])
def test_print_result_and_say_escape_control_characters(
    out: object, capfd: pytest.CaptureFixture[str]
) -> None:
    assert callable(out)
    out("a\x1b[2Jb\n" + "c" * 20_000)
    printed = "".join(capfd.readouterr())
    assert printed == "a\\x1b[2Jb\n" + "c" * 20_000 + "\n"


def test_print_result_of_a_path_is_whole_in_a_pipe(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    path = Path("/tmp/\x1b[2J")
    terminal.print_result(path)
    assert capfd.readouterr().out == "/tmp/\x1b[2J\n"
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    terminal.print_result(path)
    assert capfd.readouterr().out == "/tmp/\\x1b[2J\n"


def test_cli_escapes_names_of_files(tmp_path: Path) -> None:
    views = tmp_path / "\x1b]0;owned\x07.npy"
    np.save(views, np.zeros((3, 3, 48, 64, 3), np.uint8))
    settings = ["--set", f"scene.cache_dir={tmp_path / 'cache'}"]
    for command in (
        ["scene", "plan", str(views)],
        ["scene", "list"],
        ["scene", "info", f"{views}-none"],
        ["up", "--demo", "--camera", f"file:{views}", "--session", tmp_path.name[:20]],
    ):
        extra = settings if command[0] == "scene" else []
        result = CliRunner().invoke(cli, [*command, *extra])
        text = result.output + str(result.exception or "")
        assert "owned" in text or command == ["scene", "list"], command
        assert "\x1b" not in text, command
