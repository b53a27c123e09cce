"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


def with_config(command: F) -> F:
    """--config and --set."""
    command = click.option(
        "--set", "sets", multiple=True, metavar="KEY=VALUE", help="Change one key of the configuration; repeatable."
    )(command)
    return click.option("--config", "config_file", metavar="FILE", help="A TOML file, or the name of a preset: paper.")(command)


def with_session(command: F) -> F:
    """--session."""
    return click.option("--session", "session_name", metavar="NAME", help="Name of the session; LFPIPE_SESSION or 'default'.")(
        command
    )
