"""Writes docs/configuration.md from the tree of keys, and docs/commands.md from the commands. A test keeps both current.

python tools/make_reference.py
"""

import argparse
import inspect
import math
import re
from pathlib import Path

import click

from lfpipe.cli import cli
from lfpipe.config import options

DOCS = Path(__file__).parents[1] / "docs"
HEAD = "<!-- written by tools/make_reference.py -->\n\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def configuration() -> str:
    """The page of keys: one table per section."""
    lines = [
        "# Configuration\n",
        "Keys of the user's own file (`lfpipe config init` writes it), of `--config FILE`, and of `--set SECTION.KEY=VALUE`."
        " Later ones win. *live*: `lfpipe ctl set` changes it while a session runs."
        " *no replay*: of no effect on what a replay computes.",
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
            f"| `{name}` | {default} | {_cell(', '.join([*limits, *words]))} | {_cell(key.doc)}{marks} |"
        )
    return HEAD + "\n".join(lines) + "\n"


def _commands(command: click.Command, path: str, level: int) -> list[str]:
    context = click.Context(command, info_name=path, max_content_width=10_000)
    lines = [
        f"\n{'#' * level} {path}\n",
        "```text",
        command.get_usage(context).removeprefix("Usage: "),
        "```\n",
    ]
    text = inspect.cleandoc((command.help or "").partition("\f")[0])
    text = re.sub(
        "\b\n(.+?)\n\n", "\b\n```toml\n\\1\n```\n\n", text, flags=re.DOTALL
    )  # an example, its lines kept
    lines.append(click.formatting.wrap_text(text, 130, preserve_paragraphs=True))
    records = [
        record for one in command.get_params(context) if (record := one.get_help_record(context))
    ]
    records = [(name, text) for name, text in records if "--help" not in name]
    if records:
        lines += [
            "\n| option | |",
            "|---|---|",
            *(f"| `{_cell(name)}` | {_cell(text)} |" for name, text in records),
        ]
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            child = command.get_command(context, name)
            if child is not None and not child.hidden:
                lines += _commands(child, f"{path} {name}", min(level + 1, 4))
    return lines


def commands() -> str:
    """The page of commands with their options."""
    return HEAD + "# Commands" + "\n".join(["\n", *_commands(cli, "lfpipe", 2)]) + "\n"


PAGES = {"configuration.md": configuration, "commands.md": commands}

if __name__ == "__main__":
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    for name, text in PAGES.items():
        (DOCS / name).write_text(text())
