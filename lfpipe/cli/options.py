"""Options that several commands share, and `lfpipe completion`."""

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import get_completion_class

from lfpipe.cli.terminal import print_result
from lfpipe.config import load, updated
from lfpipe.transport.control import default_name

F = TypeVar("F", bound=Callable[..., Any])


class Number(click.FloatRange):
    """A finite number in a range. click lets NaN into every range."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = float(super().convert(value, param, ctx))
        return (
            number
            if math.isfinite(number)
            else self.fail(f"{value} is not a finite number", param, ctx)
        )


PATH = click.Path(path_type=Path)
SCENE = click.argument("path", metavar="SCENE", type=PATH)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace an output file that exists.")
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
CAMERA = click.option(
    "--camera", metavar="SRC", help="As for `lfpipe up`.  [default: the first camera]"
)
DURATION = click.option(
    "--duration",
    "duration_s",
    type=Number(0, min_open=True),
    metavar="S",
    help="Stop after S seconds.",
)
SESSION = click.option(
    "--session",
    "session_name",
    metavar="NAME",
    callback=lambda _context, _parameter, name: name or default_name(),
    help="Session name; default: LFPIPE_SESSION, else 'default'.",
)


def with_settings(command: F) -> F:
    """--config and --set, as config_file and sets."""
    command = click.option(
        "--set",
        "sets",
        multiple=True,
        metavar="KEY=VALUE",
        help="Set one configuration key; repeatable.",
    )(command)
    return click.option(
        "--config",
        "config_file",
        metavar="FILE",
        help="A TOML file, or the preset paper.",
    )(command)


def with_config(command: Callable[..., Any]) -> Callable[..., Any]:
    """--config and --set, as config: the whole configuration."""

    @with_settings
    @functools.wraps(command)
    def run(*arguments: Any, config_file: str | None, sets: tuple[str, ...], **values: Any) -> Any:
        return command(*arguments, config=load(config_file, sets), **values)

    return run


def with_scene(command: Callable[..., Any]) -> Callable[..., Any]:
    """--layout, --grid, --flip, --config and --set, as config: how to open a scene."""

    @click.option("--layout", metavar="NAME", help="Layout on disk; default: detect it.")
    @click.option(
        "--grid",
        metavar="ROWSxCOLS",
        help="Grid of views in file order; default: detect it.",
    )
    @click.option(
        "--flip",
        type=click.Choice(["none", "rows", "cols", "both"]),
        help="Reverse rows or columns of the grid.",
    )
    @with_config
    @functools.wraps(command)
    def run(*arguments: Any, config: Any, **values: Any) -> Any:
        how = {f"scene.{key}": values.pop(key) for key in ("layout", "grid", "flip")}
        config = updated(config, {key: value for key, value in how.items() if value is not None})
        return command(*arguments, config=config, **values)

    return run


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion script of a shell: eval "$(lfpipe completion bash)"."""
    from lfpipe.cli import cli

    script = get_completion_class(shell)
    assert script is not None
    print_result(script(cli, {}, "lfpipe", "_LFPIPE_COMPLETE").source())
