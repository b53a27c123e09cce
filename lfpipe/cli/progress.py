"""Output for people: lines that fit the terminal, and a progress bar on stderr, silent where nobody watches."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[str, int, int], None]  # (what is done, so many, of how many)


def filled(text: str, head: str) -> str:
    """head and text, broken between words to the terminal's width, 80 columns without one; a word stays whole, to be copied."""
    width = max(shutil.get_terminal_size((80, 24)).columns, len(head) + 20)
    return textwrap.fill(
        text, width, initial_indent=head, subsequent_indent=" " * len(head), break_long_words=False, break_on_hyphens=False
    )


@contextmanager
def progress() -> Iterator[Progress]:
    """A callback that draws one bar per kind of work."""
    from rich.console import Console
    from rich.progress import Progress as Bars

    with Bars(console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, object] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done, total=total)  # type: ignore[arg-type]

        yield report
