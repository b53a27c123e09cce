"""Options that several commands share."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from lfpipe.cli import completions
from lfpipe.transport.session import default_name

F = TypeVar("F", bound=Callable[..., Any])
SCENE = click.argument("path", metavar="SCENE", type=click.Path(path_type=Path), shell_complete=completions.scenes)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


def with_config(command: F) -> F:
    """--config and --set."""
    command = click.option(
        "--set",
        "sets",
        multiple=True,
        metavar="KEY=VALUE",
        shell_complete=completions.settings,
        help="Change one key of the configuration; repeatable.",
    )(command)
    return click.option(
        "--config",
        "config_file",
        metavar="FILE",
        shell_complete=completions.config_files,
        help="A TOML file, or the name of a preset: paper.",
    )(command)


def _session_name(_context: click.Context, _parameter: click.Parameter, name: str | None) -> str:
    return name or default_name()


def with_session(command: F) -> F:
    """--session, as session_name: str."""
    return click.option(
        "--session",
        "session_name",
        metavar="NAME",
        callback=_session_name,
        shell_complete=completions.sessions,
        help="Name of the session; LFPIPE_SESSION or 'default'.",
    )(command)


def with_camera(command: F) -> F:
    """--camera, for commands other than `up`."""
    return click.option(
        "--camera", metavar="SRC", shell_complete=completions.sources, help="As for `lfpipe up`.  [default: the first camera]"
    )(command)


def with_scene_options(command: F) -> F:
    """--layout, --grid, --flip, --transpose, --gamma, --config, --set."""
    options = [
        click.option("--layout", metavar="NAME", help="Layout on disk; detected by default."),
        click.option("--grid", metavar="ROWSxCOLS", help="Grid of views in file order, if the files do not define it."),
        click.option("--flip", type=click.Choice(["none", "rows", "cols", "both"]), help="Reverse rows or columns of the grid."),
        click.option("--transpose/--no-transpose", default=None, help="Exchange rows and columns of the grid, before any flip."),
        click.option("--gamma", metavar="G", help="Convert linear light to screen values, out = in ** (1/G); 1 for none."),
        click.option("--force", is_flag=True, help="Open pictures even if they do not look like one light field."),
        with_config,
    ]
    for option in reversed(options):
        command = option(command)
    return command
