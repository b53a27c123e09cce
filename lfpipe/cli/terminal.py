"""Output of commands: results on stdout, messages on stderr, neither with control characters;
progress as a bar, or in a log as one line per slow task. Options that several commands share, and
`lfpipe completion`. And commands and options that other packages add, by entry points of the group
`lfpipe.commands`.

The name of an entry point is its place: `sweep` is a command, `scene.export` a command of the group
`scene`, `up.--share` an option of the command `up`. Its object is imported to list commands, so its
module must be light; what it names is imported when it is used.
"""

import copy
import functools
import math
import os
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass  # `import attrs` would take as long as the rest of --help
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import get_completion_class

from lfpipe.errors import ERROR_FILE, UserError, escaped, plain
from lfpipe.host.terminal import drop_output
from lfpipe.plugins import COMMANDS, load, load_target, plugins

F = TypeVar("F", bound=Callable[..., Any])
QUIET_S = 5.0  # a shorter wait needs no line
Progress = Callable[[str, int, int], None]  # (task, steps done, steps in total)


def print_result(result: str | Path) -> None:
    """Prints a result on stdout. Text is `escaped`: a terminal obeys escape sequences in names
    of files. A path alone is for scripts: into a pipe or a file go its own bytes.
    """
    if isinstance(result, Path) and sys.stdout is not None and not sys.stdout.isatty():
        click.echo(os.fsencode(result))
    else:
        click.echo(escaped(str(result)))


def say(text: str) -> None:
    """Prints messages on stderr, `escaped`: stdout is for results. A session whose terminal is
    closed goes on without it.
    """
    try:
        click.echo(escaped(text), err=True)
    except OSError:
        if os.path.sameopenfile(1, 2):
            drop_output(1)
        drop_output(2)


def print_error(error: UserError) -> None:
    """Prints the error that ended a command, and passes it to the parent program."""
    say(f"error: {error}")
    if path := os.environ.get(ERROR_FILE):
        from lfpipe.files.safe_files import write_file  # it imports attrs

        write_file(Path(path), error.to_json())


def filled(text: str, head: str) -> str:
    """head and text, wrapped to the terminal's width, or 80 columns without a terminal.

    Words stay whole, for copying.
    """
    width = max(shutil.get_terminal_size((80, 24)).columns, len(head) + 20)
    return textwrap.fill(
        text,
        width,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_long_words=False,
        break_on_hyphens=False,
    )


@contextmanager
def progress() -> Iterator[Progress]:
    """Yields a callback that draws one bar per task on a terminal; elsewhere it writes one line for
    a task of QUIET_S or more, so that a minute of silence does not look like a hang.
    """
    if not sys.stderr.isatty():
        began: dict[str, float] = {}

        def line(what: str, done: int, total: int) -> None:
            if time.monotonic() - began.setdefault(what, time.monotonic()) > QUIET_S:
                began[what] = math.inf  # once
                say(f"{what}: {done} of {total}")

        yield line
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    with Bars(console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(escape(plain(what)), total=total)
            bars.update(tasks[what], completed=done, total=total)

        yield report


@dataclass(frozen=True)
class AddedCommand:
    """A command of another package."""

    summary: str
    """Its line in the list of commands."""
    target: str
    """The click command, as MODULE:NAME."""


@dataclass(frozen=True)
class AddedOption:
    """One or more options of a command, of another package."""

    options: tuple[click.Option, ...]
    """Their values are passed to the wrapper."""
    wrapper: str
    """MODULE:NAME of `wrapper(proceed, **values)`, which runs in place of the command; values: of
    all options and arguments. proceed(**values) runs the command without the added options."""


A = TypeVar("A", AddedCommand, AddedOption)


def added(place: str, kind: type[A]) -> dict[str, A]:
    """What other packages add to a command or group, by name. place: "" for `lfpipe` itself.

    Raises UserError if one is broken.
    """
    parts: dict[str, A] = {}
    for entry in plugins(COMMANDS):
        where, _, name = entry.rpartition(".")
        if where == place and isinstance(part := load(COMMANDS, entry), kind):
            parts[name] = part
    return parts


def with_added_options(command: click.Command, path: str) -> click.Command:
    """The command with the options that other packages add. path: its words, joined by dots."""
    for name, more in added(path, AddedOption).items():
        command = copy.copy(command)
        command.params = [*command.params, *more.options]
        command.callback = functools.partial(
            _wrapped, f"{path}.{name}", more.wrapper, command.callback
        )
    return command


def _wrapped(
    entry: str, wrapper: str, proceed: Callable[..., Any] | None, *arguments: Any, **values: Any
) -> Any:
    assert proceed is not None, "a command, not a group"
    return load_target(COMMANDS, entry, wrapper)(functools.partial(proceed, *arguments), **values)


class Group(click.Group):
    """A group whose help has whole summaries."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Whole summaries, on as many lines as they take; click cuts them."""
        commands = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
        with formatter.section("Commands"):
            formatter.write_dl(
                [
                    (name, command.get_short_help_str(sys.maxsize))
                    for name, command in commands
                    if command is not None and not command.hidden
                ]
            )


class ExtensibleGroup(Group):
    """A group to which other packages add commands, and options to its commands."""

    @property
    def place(self) -> str:
        """Where entry points add to it; "" for `lfpipe` itself."""
        return self.name or ""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All names, also the added ones."""
        return sorted({*super().list_commands(ctx), *added(self.place, AddedCommand)})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """The command of that name, with the options that other packages add."""
        path = f"{self.place}.{name}".lstrip(".")
        command = self.own_command(ctx, name)
        if command is None and name in (more := added(self.place, AddedCommand)):
            command = load_target(COMMANDS, path, more[name].target)
        return command and with_added_options(command, path)

    def own_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """The built-in command of that name."""
        return super().get_command(ctx, name)


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


def _session_name(_context: click.Context, _parameter: click.Parameter, name: str | None) -> str:
    from lfpipe.transport.control import default_name

    return name or default_name()


SESSION = click.option(
    "--session",
    "session_name",
    metavar="NAME",
    callback=_session_name,
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
        from lfpipe import config

        return command(*arguments, config=config.load(config_file, sets), **values)

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
        from lfpipe.config import updated

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
