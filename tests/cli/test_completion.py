"""Completions on Tab: what a shell's script gets."""

import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from lfpipe.cli import cli


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("up --demo --set render.me", ["render.method="]),
        ("up --demo --set render.method=wa", ["render.method=warp", "render.method=warp2"]),
        ("ctl set render.swap_eyes=", ["render.swap_eyes=true", "render.swap_eyes=false"]),
        ("ctl --session e", ["evening"]),
        ("monit", ["monitor"]),
    ],
)
def test_keys_words_and_sessions_are_offered(line: str, offered: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfpipe.supervisor.rundir.running", lambda: ["evening", "morning"])
    *words, incomplete = line.split()
    found = ShellComplete(cli, {}, "lfpipe", "_LFPIPE_COMPLETE").get_completions(words, incomplete)
    assert [item.value for item in found] == offered


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_gets_a_script(shell: str) -> None:
    assert "_LFPIPE_COMPLETE" in CliRunner().invoke(cli, ["completion", shell]).output
