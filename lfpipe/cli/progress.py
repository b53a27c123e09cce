"""Output for people: lines that fit the terminal; progress on stderr as a bar, or in a log as a line for what takes long."""

import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from lfpipe.host.paths import exists

QUIET_S = 5.0
Progress = Callable[[str, int, int], None]  # (task, steps done, steps in total)


def filled(text: str, head: str) -> str:
    """head and text, wrapped to the terminal's width, or 80 columns without a terminal. Words stay whole, for copying."""
    width = max(shutil.get_terminal_size((80, 24)).columns, len(head) + 20)
    return textwrap.fill(
        text, width, initial_indent=head, subsequent_indent=" " * len(head), break_long_words=False, break_on_hyphens=False
    )


@contextmanager
def progress() -> Iterator[Progress]:
    """Yields a callback that draws one bar per task on a terminal; elsewhere it writes one line for a task of QUIET_S or more."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console
    from rich.progress import Progress as Bars

    with Bars(console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, object] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done, total=total)  # type: ignore[arg-type]

        yield report


def _lines() -> Progress:
    """A callback for a log: nobody should take a minute of silence for a hang."""
    began: dict[str, float] = {}
    said: set[str] = set()

    def report(what: str, done: int, total: int) -> None:
        if time.monotonic() - began.setdefault(what, time.monotonic()) > QUIET_S and what not in said:
            said.add(what)
            click.echo(f"{what}: {done} of {total}", err=True)

    return report


@contextmanager
def growing_file(path: Path | None) -> Iterator[None]:
    """Shows on a terminal the size of the file at path and the time elapsed."""
    if path is None or not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    ended, began = threading.Event(), time.monotonic()

    def watch() -> None:
        with Console(stderr=True).status("", refresh_per_second=2) as status:
            while not ended.wait(0.5):
                size_mb = path.stat().st_size / 1e6 if exists(path) else 0.0
                status.update(f"{path.name}: {size_mb:.1f} MB after {time.monotonic() - began:.0f} s; Ctrl-C ends it")

    watcher = threading.Thread(target=watch, name="growing-file", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()
