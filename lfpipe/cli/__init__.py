"""The command line.

Each command is a few lines that call a package below; packages are imported when a command runs.
"""

import codecs
import contextlib
import errno
import importlib
import io
import logging
import os
import sys
from collections.abc import Callable, Iterator
from typing import NoReturn

import click

from lfpipe._version import __version__
from lfpipe.cli.terminal import AddedCommand, ExtensibleGroup, added, print_error, say
from lfpipe.errors import UserError
from lfpipe.host import signals
from lfpipe.host.terminal import drop_output, open_standard_files
from lfpipe.log import set_up

# command -> its module and summary, in order of use
COMMANDS = {
    "up": ("lfpipe.cli.sessions", "Show a light field from the position of your eyes."),
    "monitor": ("lfpipe.cli.sessions", "Show latency, rate, drops and load of a running session."),
    "ctl": ("lfpipe.cli.sessions", "Query and control a running session."),
    "scene": ("lfpipe.cli.scene", "Pack, list and inspect light fields."),
    "cameras": ("lfpipe.cli.machine", "List cameras with formats, sizes and rates."),
    "calibrate": ("lfpipe.cli.machine", "Measure and store the focal length of the camera."),
    "doctor": ("lfpipe.cli.machine", "Check this machine."),
    "models": ("lfpipe.cli.machine", "Download the face networks if mediapipe has no wheel."),
    "config": ("lfpipe.cli.machine", "Write, show and check the configuration."),
    "trace": ("lfpipe.cli.sessions", "Record timelines of a running session for Perfetto."),
    "record": ("lfpipe.cli.sequence", "Record a camera to a new folder."),
    "replay": ("lfpipe.cli.sequence", "Run a recorded sequence; compare with a reference."),
    "sequence": ("lfpipe.cli.sequence", "Inspect, cut, import and export recordings."),
    "bench": ("lfpipe.cli.bench", "Measure error against run time."),
    "completion": ("lfpipe.cli.terminal", "Print the completion script of a shell."),
}

# of the list of commands; those of other packages follow under "More"
GROUPS = {
    "View": ("up", "scene", "cameras", "calibrate"),
    "Watch and control": ("monitor", "ctl", "trace"),
    "Record and measure": ("record", "replay", "sequence", "bench"),
    "This machine": ("doctor", "config", "models", "completion"),
}


class Commands(ExtensibleGroup):
    """The commands of COMMANDS, and those of other packages.

    Each module is imported when its command runs. The error for an unknown command suggests the
    closest one.
    """

    @property
    def place(self) -> str:
        return ""

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except BrokenPipeError:  # here, because click would end with 1
            _reader_ended()

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for name, _ in self._summaries()]

    def own_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command: click.Command = getattr(importlib.import_module(COMMANDS[name][0]), name)
        return command

    def _summaries(self) -> list[tuple[str, str]]:
        """(command, summary)."""
        own = {name: summary for name, (_, summary) in COMMANDS.items()}
        more = {name: one.summary for name, one in added(self.place, AddedCommand).items()}
        return list((own | more | own).items())  # a built-in command keeps its position and summary

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        summaries = dict(self._summaries())
        width = max(map(len, summaries))
        grouped = [name for names in GROUPS.values() for name in names]
        groups = GROUPS | {"More": tuple(name for name in summaries if name not in grouped)}
        for title, names in groups.items():
            rows = [(f"{name:{width}}", summaries[name]) for name in names if name in summaries]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            from lfpipe.config.check import closest

            close = closest(args[0], self.list_commands(ctx), 0.5)
            raise click.UsageError(
                f"{error.message} Did you mean {close!r}?" if close else error.message, ctx
            ) from None


@click.group(
    cls=Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="lfpipe")
@click.option(
    "-v",
    "--verbose",
    count=True,
    help="Log decisions (-v) and details (-vv) to standard error.",
)
@click.pass_context
def cli(context: click.Context, verbose: int) -> int | None:
    """View light fields in 3D: a webcam tracks your eyes, and red/cyan glasses show each eye its
    own view.

    Start with: lfpipe up --demo. On a desktop, lfpipe without a command opens the start page.
    """
    set_up(verbose)
    if context.invoked_subcommand is not None:
        return None
    from lfpipe.render.display.display import has_display

    if not has_display():
        raise click.exceptions.NoArgsIsHelpError(context)
    from lfpipe.cli.sessions import UpArguments, launch

    return launch(UpArguments(start=True))


def _path_bytes(error: UnicodeError) -> tuple[str | bytes, int]:
    """Encoding error handler for stdout: writes paths as their original bytes, escapes the rest."""
    try:
        return codecs.lookup_error("surrogateescape")(error)
    except UnicodeError:
        return codecs.backslashreplace_errors(error)


def _check_working_folder() -> None:
    try:
        os.getcwd()  # noqa: PTH109 - only whether there is one
    except OSError as error:
        raise UserError(
            f"the working directory cannot be used: {error.strerror}",
            "change to one that exists: `cd`",
        ) from None


@contextlib.contextmanager
def machine_errors() -> Iterator[None]:
    """Turns what the machine causes into UserError: a full disk, a folder without permissions, a
    lost drive, too little memory.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        remedy = (
            "free some space"
            if error.errno in (errno.ENOSPC, errno.EDQUOT)
            else "set TMPDIR to a folder that you may write to"
            if "temporary directory" in str(error)
            else "check that path and its permissions"
        )
        raise UserError(
            f"{where}{error.strerror or error}", f"{remedy}; -vv shows where it failed"
        ) from error
    except (MemoryError, ImportError) as error:
        if isinstance(error, ImportError) and "failed to map" not in str(error):
            raise
        raise UserError(
            "not enough memory",
            "close other programs, or raise the limit (`ulimit -d`, `ulimit -v`)",
        ) from error


def _end_output() -> None:
    """Flushes stdout if possible, then redirects it to the null device."""
    if sys.stdout is None:
        return
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    drop_output(sys.stdout.fileno())


def _reader_ended() -> NoReturn:
    """For a closed pipe, as in `lfpipe ... | head`."""
    _end_output()
    sys.exit(141)


def run(notify: Callable[[UserError], None] = print_error) -> NoReturn:
    """Runs the command line and ends the process. A user error prints one message and ends with
    exit code 2.

    notify: shows an error.
    """

    def fail(error: UserError) -> NoReturn:
        logging.getLogger(__name__).debug("the command failed", exc_info=True)
        _end_output()
        notify(error)
        sys.exit(2)

    open_standard_files()
    codecs.register_error("path", _path_bytes)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="path")
    signals.end_cleanly()
    try:
        with machine_errors():
            _check_working_folder()
            code = cli(prog_name="lfpipe", standalone_mode=False)
            if sys.stdout is not None:  # closed by the parent process
                sys.stdout.flush()
    except UserError as error:
        fail(error)
    except click.ClickException as error:
        words = io.StringIO()
        error.show(words)
        say(words.getvalue().rstrip())
        sys.exit(2)
    except click.Abort as error:
        sys.exit(signals.exit_code(error.__cause__))
    except BrokenPipeError:
        _reader_ended()
    sys.exit(code if isinstance(code, int) else 0)
