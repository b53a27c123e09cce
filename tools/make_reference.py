"""Writes docs/configuration.md from the tree of keys, and docs/commands.md from the commands. A
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
HEAD = "<!-- written by tools/make_reference.py -->\n\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def configuration() -> str:
    """The page of keys: one table per section."""
    lines = [
        "# Configuration\n",
        (
            "Keys of the user's own file (`lfpipe config init` writes it), of `--config FILE`, and"
            " of `--set SECTION.KEY=VALUE`. Later ones win. *live*: `lfpipe ctl set` changes it"
            " while a session runs. *no replay*: of no effect on what a replay computes."
        ),
    ]
    section = ""
    for dotted, key in options().items():
        head, _, name = dotted.partition(".")
        if head != section:
            section = head
            lines += [
                f"\n## [{head}]\n",
                "| key | default | values | meaning |",
                "|---|---|---|---|",
            ]
        words = [f"`{word}`" for word in key.words]
        limits = (
            [f"{key.low:g} to {key.high:g} {key.unit}".strip()]
            if math.isfinite(key.low)
            else [key.unit]
            if key.unit
            else []
        )
        marks = "".join(
            f" *{mark}*"
            for mark, holds in (("live", key.live), ("no replay", not key.replays))
            if holds
        )
        default = (
            f"`{str(key.default).lower() if isinstance(key.default, bool) else key.default}`"
            if key.default != ""
            else ""
        )
        lines.append(
            f"| `{name}` | {default} | {_cell(', '.join([*limits, *words]))} |"
            f" {_cell(key.doc)}{marks} |"
        )
    return HEAD + "\n".join(lines) + "\n"


def _tree(command: click.Command, path: str) -> Iterator[tuple[click.Command, str]]:
    """The command and those below it that help lists, each with its words."""
    yield command, path
    if isinstance(command, click.Group):
        context = click.Context(command, info_name=path)
        for name in command.list_commands(context):
            child = command.get_command(context, name)
            if child is not None and not child.hidden:
                yield from _tree(child, f"{path} {name}")


def _records(command: click.Command, context: click.Context) -> list[tuple[str, str]]:
    """(option, help) of each option but --help."""
    records = [option.get_help_record(context) for option in command.get_params(context)]
    return [record for record in records if record and "--help" not in record[0]]


def _listed(records: Iterable[tuple[str, str]]) -> list[str]:
    return ["", *(f"- `{name}`: {text}" for name, text in records)]


def _command(command: click.Command, path: str, shared: Collection[tuple[str, str]]) -> list[str]:
    """The section of one command; of the shared options only the names."""
    context = click.Context(command, info_name=path, max_content_width=10_000)
    level = min(path.count(" ") + 2, 4)
    usage = command.get_usage(context).removeprefix("Usage: ")
    usage = re.sub(r" \[OPTIONS\]| \[?COMMAND\]? \[ARGS\]\.\.\.", "", usage)
    lines = [f"\n{'#' * level} `{usage}`\n"]
    text = inspect.cleandoc((command.help or "").partition("\f")[0])
    # an example, its lines kept
    text = re.sub("\b\n(.+?)\n\n", "\b\n```toml\n\\1\n```\n\n", text, flags=re.DOTALL)
    lines.append(click.formatting.wrap_text(text, 130, preserve_paragraphs=True))
    records = _records(command, context)
    if own := [record for record in records if record not in shared]:
        lines += _listed(own)
    if common := [record for record in records if record in shared]:
        names = ", ".join(f"`{name.split()[0].rstrip(',')}`" for name, _ in common)
        lines.append(f"\nAlso {names}.")
    return lines


def commands() -> str:
    """The page of commands with their options: those of several commands once, at its head."""
    tree = [*_tree(cli, "lfpipe")]
    counts = Counter(
        record for command, path in tree for record in _records(command, click.Context(command))
    )
    shared = [record for record, count in counts.items() if count >= SEVERAL]
    sections = [line for command, path in tree for line in _command(command, path, shared)]
    lines = ["# Commands\n", "Options of several commands:", *_listed(shared), *sections]
    return HEAD + "\n".join(lines) + "\n"


PAGES = {"configuration.md": configuration, "commands.md": commands}

if __name__ == "__main__":
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    for name, text in PAGES.items():
        (DOCS / name).write_text(text())
