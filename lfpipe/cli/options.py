"""Options that several commands share."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from lfpipe.cli import completions
from lfpipe.config import load, updated
from lfpipe.transport.session import default_name

F = TypeVar("F", bound=Callable[..., Any])
PATH = click.Path(path_type=Path)
SCENE = click.argument("path", metavar="SCENE", type=PATH)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
CAMERA = click.option("--camera", metavar="SRC", help="As for `lfpipe up`.  [default: the first camera]")
DURATION = click.option(
    "--duration", "duration_s", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Stop after S seconds."
)
SESSION = click.option(
    "--session",
    "session_name",
    metavar="NAME",
    callback=lambda _context, _parameter, name: name or default_name(),
    shell_complete=completions.sessions,
    help="Name of the session; LFPIPE_SESSION or 'default'.",
)


def with_settings(command: F) -> F:
    """--config and --set, as config_file and sets."""
    command = click.option(
        "--set",
        "sets",
        multiple=True,
        metavar="KEY=VALUE",
        shell_complete=completions.settings,
        help="Change one key of the configuration; repeatable.",
    )(command)
    return click.option("--config", "config_file", metavar="FILE", help="A TOML file, or the name of a preset: paper.")(command)


def with_config(command: Callable[..., Any]) -> Callable[..., Any]:
    """--config and --set, as config: the whole configuration."""

    @with_settings
    @functools.wraps(command)
    def run(*given: Any, config_file: str | None, sets: tuple[str, ...], **options: Any) -> Any:
        return command(*given, config=load(config_file, sets), **options)

    return run


def with_scene(command: Callable[..., Any]) -> Callable[..., Any]:
    """How to open a scene: --layout, --grid, --flip, --force, --config, --set, as config."""

    @click.option("--layout", metavar="NAME", help="Layout on disk; detected by default.")
    @click.option("--grid", metavar="ROWSxCOLS", help="Grid of views in file order, if the files do not define it.")
    @click.option("--flip", type=click.Choice(["none", "rows", "cols", "both"]), help="Reverse rows or columns of the grid.")
    @click.option("--force", is_flag=True, default=None, help="Open pictures even if they do not look like one light field.")
    @with_config
    @functools.wraps(command)
    def run(*given: Any, config: Any, **options: Any) -> Any:
        how = {f"scene.{key}": options.pop(key) for key in ("layout", "grid", "flip", "force")}
        config = updated(config, {key: value for key, value in how.items() if value is not None})
        return command(*given, config=config, **options)

    return run
