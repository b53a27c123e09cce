"""Output of commands: results on stdout, messages on stderr, neither with control characters;
progress as a bar, or in a log as one line per slow task.
"""

import math
import os
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from lfpipe.errors import ERROR_FILE, UserError, escaped, plain
from lfpipe.files.safe_files import write_file
from lfpipe.host.terminal import drop_output

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
