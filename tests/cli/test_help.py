"""Help fits a terminal of 80 columns, whole."""

from collections.abc import Iterator

import click
import pytest
from click.testing import CliRunner

from lfpipe.cli import GROUPS, cli


def groups(command: click.Command, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The path of each group below a command, itself included."""
    if not isinstance(command, click.Group):
        return
    yield path
    context = click.Context(command)
    for name in command.list_commands(context):
        if (below := command.get_command(context, name)) is not None:
            yield from groups(below, (*path, name))


@pytest.mark.parametrize("path", groups(cli), ids=" ".join)
def test_help_of_every_group_has_whole_summaries(path: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(cli, [*path, "--help"], env={"COLUMNS": "80"}).output
    assert max(map(len, shown.splitlines())) <= 80
    commands = shown.partition("\nCommands:\n")[2]
    assert not [line for line in commands.splitlines() if line.endswith("...")]


def test_every_command_has_a_group_of_the_help() -> None:
    shown = CliRunner().invoke(cli, ["--help"], env={"COLUMNS": "80"}).output
    named = [
        line.split()[0]
        for line in shown.splitlines()
        if line.startswith("  ") and line[2:3].isalpha()
    ]
    for title, names in GROUPS.items():
        assert f"{title}:" in shown and set(names) <= set(named)
    assert set(cli.list_commands(click.Context(cli))) <= set(named)
