"""Generates docs/configuration.md from the tree of keys and docs/commands.md from the commands. A
test keeps both current.

python -m tools.make_reference
"""

import argparse
import inspect
import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import click

from lfpipe.cli import cli
from lfpipe.config import options

DOCS = Path(__file__).parents[1] / "docs"
SEVERAL = 3  # commands with the same option, which the page then describes once
Record = tuple[str, str]  # an option and its help
HEAD = "<!-- written by tools/make_reference.py -->\n\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def configuration() -> str:
    """The page of keys: one table per section."""
    lines = [
        "# Configuration\n",
        (
            "Set keys in your settings (`lfpipe config init` writes the file), with"
            " `--config FILE`, or with `--set SECTION.KEY=VALUE`; the last one wins. The first"
            " value is the default. *live*: `lfpipe ctl set` changes the key in a running session."
            " *no replay*: the key has no effect on a replay."
        ),
    ]
    section = ""
    for dotted, key in options().items():
        head, _, name = dotted.partition(".")
        if head != section:
            section = head
            lines += [f"\n## [{head}]\n", "| key | values | meaning |", "|---|---|---|"]
        default = str(key.default).lower() if isinstance(key.default, bool) else str(key.default)
        values = [f"`{word}`" for word in (default, *key.words) if word != ""]
        if math.isfinite(key.low):
            values.append(f"{key.low:g} to {key.high:g} {key.unit}".strip())
        elif key.unit:
            values.append(key.unit)
        marks = "".join(
            f" *{mark}*"
            for mark, holds in (("live", key.live), ("no replay", not key.replays))
            if holds
        )
        # the default once, at the head
        listed = _cell(", ".join(dict.fromkeys(values)))
        lines.append(f"| `{name}` | {listed} | {_cell(key.doc)}{marks} |")
    return HEAD + "\n".join(lines) + "\n"


def _below(command: click.Command, path: str) -> list[tuple[click.Command, str]]:
    """The commands of a group that help lists, each with its words; of a command none."""
    if not isinstance(command, click.Group):
        return []
    context = click.Context(command, info_name=path)
    found = ((command.get_command(context, name), name) for name in command.list_commands(context))
    return [(child, f"{path} {name}") for child, name in found if child and not child.hidden]


def _tree(command: click.Command, path: str) -> Iterator[tuple[click.Command, str]]:
    """The command and those below it, each with its words."""
    yield command, path
    for child, words in _below(command, path):
        yield from _tree(child, words)


def _records(command: click.Command, context: click.Context) -> list[Record]:
    """(option, help) of each option but --help."""
    records = [option.get_help_record(context) for option in command.get_params(context)]
    return [record for record in records if record and "--help" not in record[0]]


def _listed(records: Iterable[Record]) -> list[str]:
    return ["", *(f"- `{name}`: {text}" for name, text in records)]


def _of_each(command: click.Command, shared: Collection[Record]) -> list[Record]:
    """The shared options of the command; of a group those that all of its commands have, too."""
    own = [record for record in _records(command, click.Context(command)) if record in shared]
    below = [_of_each(child, shared) for child, _ in _below(command, "")]
    return own + [
        record for record in shared if below and all(record in options for options in below)
    ]


def _command(
    command: click.Command, path: str, shared: Collection[Record], above: Collection[Record] = ()
) -> list[str]:
    """The sections of a command and of those below it; of the shared options only the names, and
    of a group's once. above: the options named there.
    """
    context = click.Context(command, info_name=path, max_content_width=10_000)
    level = min(path.count(" ") + 2, 4)
    usage = command.get_usage(context).removeprefix("Usage: ")
    usage = re.sub(r" \[OPTIONS\]| \[?COMMAND\]? \[ARGS\]\.\.\.", "", usage)
    lines = [f"\n{'#' * level} `{usage}`\n"]
    text = inspect.cleandoc((command.help or "").partition("\f")[0])
    # an example, its lines kept
    text = re.sub("\b\n(.+?)\n\n", "\b\n```toml\n\\1\n```\n\n", text, flags=re.DOTALL)
    lines.append(click.formatting.wrap_text(text, 130, preserve_paragraphs=True))
    if own := [record for record in _records(command, context) if record not in shared]:
        lines += _listed(own)
    common = _of_each(command, shared)
    if new := [record for record in common if record not in above]:
        names = ", ".join(f"`{name.split()[0].rstrip(',')}`" for name, _ in new)
        lines.append(f"\nAlso {names}.")
    below = _below(command, path)
    return lines + [
        line for child, words in below for line in _command(child, words, shared, common)
    ]


def commands() -> str:
    """The page of commands with their options: those of several commands once, at its head."""
    counts = Counter(
        record
        for command, _ in _tree(cli, "lfpipe")
        for record in _records(command, click.Context(command))
    )
    shared = [record for record, count in counts.items() if count >= SEVERAL]
    head = "Options of several commands; those of a group are those of its commands:"
    lines = ["# Commands\n", head, *_listed(shared), *_command(cli, "lfpipe", shared)]
    return HEAD + "\n".join(lines) + "\n"


PAGES = {"configuration.md": configuration, "commands.md": commands}

if __name__ == "__main__":
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    for name, text in PAGES.items():
        (DOCS / name).write_text(text())
