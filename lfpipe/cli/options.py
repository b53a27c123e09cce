"""Options that several commands share."""

from collections.abc import Callable
from typing import Any, TypeVar

import click

from lfpipe.cli import completions

F = TypeVar("F", bound=Callable[..., Any])


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


def with_session(command: F) -> F:
    """--session."""
    return click.option(
        "--session",
        "session_name",
        metavar="NAME",
        shell_complete=completions.sessions,
        help="Name of the session; LFPIPE_SESSION or 'default'.",
    )(command)


def with_camera(command: F) -> F:
    """--camera, for commands other than `up`."""
    return click.option(
        "--camera", metavar="SRC", shell_complete=completions.sources, help="As for `lfpipe up`.  [default: the first camera]"
    )(command)
