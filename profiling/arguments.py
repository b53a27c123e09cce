"""The command lines of the scripts here."""

from __future__ import annotations

import argparse


def parser_of(doc: str | None, **numbers: float) -> argparse.ArgumentParser:
    """A parser that prints doc for --help, with an option for each number: of its type, with its value for default."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in numbers.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value)
    return parser
