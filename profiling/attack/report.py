"""The table of a run."""

import re
from collections import Counter

from profiling.attack.book import Book
from profiling.attack.case import FAILURES, MEMORY

NAMES = {
    "ended": "sessions ended",
    "traceback": "tracebacks, crashes, wrong exit codes",
    "hang": "hangs",
    "half-applied": "half-applied changes",
    MEMORY: "refusals over 300 MB",
    "answer": "answers above 64 KiB, without words or malformed",
}


KINDS = "fifo|folder|dangling link|loop of links|link out|link to a device|link in|socket|empty|sparse|device|gone"
SPECIAL = re.compile(rf"\ba ({KINDS})( for [\w. -]+)?$")


def rows(book: Book) -> dict[tuple[str, str], Counter[str]]:
    """Counts by part and what was tried. Of scenes, the layout and what was done to it are counted each for itself."""
    found: dict[tuple[str, str], Counter[str]] = {}
    for (part, kind), counter in book.counts.items():
        what, _, how = SPECIAL.sub("no ordinary file in its place", kind).partition(": ")
        names = [f"layout {what}", f"any layout: {how}"] if part == "scenes" and how else [f"{what}: {how}" if how else what]
        for name in names:
            found.setdefault((part, name), Counter()).update(counter)
    return found


def table(book: Book) -> str:
    """Markdown: totals, what was tried, and each cause of failure with what repeats it."""
    lines = [
        "# Attack",
        "",
        f"`uv run python -m profiling.attack --seed {book.seed}`: {book.inputs} hostile inputs against the real program.",
        "",
        "| total | count |",
        "|---|---|",
        f"| inputs | {book.inputs} |",
        f"| taken as valid | {book.total('accepted')} |",
        f"| refused, or ignored where nothing answers | {book.total('refused')} |",
        *(f"| {NAMES[name]} | {book.total(name)} |" for name in FAILURES),
        *(f"| peak memory of a refusal, {part} | {peak:.0f} MB |" for part, peak in book.peak_mb.items() if peak),
        *(f"| {note.partition(': ')[0]} | {note.partition(': ')[2]} |" for note in book.notes),
        "",
        "| part | what was tried | inputs | accepted | refused or ignored | failed |",
        "|---|---|---|---|---|---|",
    ]
    for (part, kind), counter in sorted(rows(book).items()):
        failed = sum(counter[name] for name in FAILURES)
        lines.append(f"| {part} | {kind} | {sum(counter.values())} | {counter['accepted']} | {counter['refused']} | {failed} |")
    if book.causes:
        lines += ["", "| cause of failure | what | inputs | repeat |", "|---|---|---|---|"]
        for cause in sorted(book.causes.values(), key=lambda cause: -cause.count):
            group = cause.group.replace("|", "/").replace("\n", " ")
            lines.append(
                f"| {cause.part}: {group} | {cause.outcome} | {cause.count} | {', '.join(map(str, cause.numbers[:2]))} |"
            )
    return "\n".join(lines) + "\n"
