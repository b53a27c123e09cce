"""Commands and options of other packages: listed, run, and skipped if they are broken."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from lfpipe.cli import cli
from lfpipe.monitor.doctor import plugin_check
from lfpipe.plugins import COMMANDS, entries
from tests.support.world import write_package

MODULE = """
import click
from lfpipe.cli.plugged import AddedCommand, AddedOption

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
broken = nowhere:COMMAND
odd = parts:more
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
    assert "broken" not in listed and "odd" not in listed
    assert "more" in said("scene", "--help")
    assert said("more") == said("scene", "more") == "more is done\n"


def test_options_of_another_package_wrap_the_command() -> None:
    assert "--twice" in said("scene", "list", "--help")
    assert said("scene", "list", "--twice") == "twice True, ['as_json', 'config_file', 'sets']\n"
    assert "0 packs" in said("scene", "list")


def test_doctor_reports_a_broken_command() -> None:
    assert "No module named 'nowhere'" in plugin_check(COMMANDS, "broken", "parts 1.0").detail
