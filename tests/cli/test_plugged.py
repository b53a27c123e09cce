"""Commands and options of other packages: listed, run, and named if they are broken."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from lfpipe.cli import cli
from lfpipe.errors import UserError
from lfpipe.plugins import COMMANDS, entries
from tests.support.world import write_package

MODULE = """
import click
from lfpipe.cli.terminal import AddedCommand, AddedOption

COMMAND = AddedCommand("Do more.", "parts:more")
OPTION = AddedOption((click.Option(["--twice"], is_flag=True),), "parts:twice")
more = click.Command("more", callback=lambda: click.echo("more is done"))

def twice(proceed, *, twice, **values):
    click.echo(f"twice {twice}, {sorted(values)}")
    return None if twice else proceed(**values)
"""
ENTRIES = f"""[{COMMANDS}]
more = parts:COMMAND
scene.more = parts:COMMAND
scene.list.--twice = parts:OPTION
up = parts:COMMAND
"""


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    write_package(tmp_path, ENTRIES, "parts")
    (tmp_path / "parts.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    entries.cache_clear()
    yield
    entries.cache_clear()


def said(*words: str) -> str:
    return CliRunner().invoke(cli, words).output


def test_commands_of_another_package_are_listed_and_run() -> None:
    listed = said("--help")
    assert "Do more." in listed and "Show a light field from the" in listed, "the built-in `up`"
    assert "more" in said("scene", "--help")
    assert said("more") == said("scene", "more") == "more is done\n"


def test_options_of_another_package_wrap_the_command() -> None:
    assert "--twice" in said("scene", "list", "--help")
    assert said("scene", "list", "--twice") == "twice True, ['as_json', 'config_file', 'sets']\n"
    assert "0 packs" in said("scene", "list")


def test_broken_command_is_named(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text("raise SystemExit(3)")
    sys.modules.pop("parts", None)
    error = CliRunner().invoke(cli, ["more"]).exception
    assert isinstance(error, UserError), error
    assert "more of parts 1.0 (lfpipe.commands): SystemExit: 3" in error.message
