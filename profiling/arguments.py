"""Command lines of the scripts here, and what they share."""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

LFPIPE = [sys.executable, "-m", "lfpipe"]


def parser_of(doc: str | None, **numbers: float) -> argparse.ArgumentParser:
    """A parser that prints doc for --help, with one option per number: its type and its default."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, value in numbers.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value)
    return parser


def existing(text: str) -> Path:
    """The type of an argument that names a file or folder; argparse reports a missing one and exits
    with 2.
    """
    path = Path(text)
    if not path.exists():
        raise argparse.ArgumentTypeError(f"no such file or folder: {text}")
    return path


def start(main: Callable[[], int | None]) -> None:
    """Runs main and exits; an error of the user is printed without a traceback and exits with 2."""
    from lfpipe.errors import UserError

    try:
        sys.exit(main())
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def session_state(name: str) -> dict[str, Any]:
    """What `lfpipe monitor` reports of a session."""
    done = subprocess.run(
        [*LFPIPE, "monitor", "--session", name, "--once", "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    state: dict[str, Any] = json.loads(done.stdout)
    return state
