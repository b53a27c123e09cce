"""`lfpipe up --kiosk`: checks before an exhibition, and restarts without an operator."""

import time
from collections.abc import Callable

import click

from lfpipe.errors import UserError

AGAIN_S = 2.0  # pause between a failed session and the next


def check_exhibition(code: str | None, counted: bool, display: str) -> None:
    """Raises UserError if the exhibition has no screen or no usable code. counted: visitors are counted."""
    from lfpipe.config.session_options import check_code

    if counted and code is None:
        raise UserError("--visits without --kiosk: only an exhibition counts visitors", "add --kiosk CODE, or leave it out")
    if code is not None:
        check_code(code)
        if display not in ("window", "fullscreen"):
            raise UserError(f"--kiosk with --display {display}: an exhibition needs a screen", "leave out one or the other")


def until_it_ends(first: Callable[[], int], again: Callable[[], int]) -> int:
    """Runs sessions until one ends without failure: an exhibition has no operator to restart it."""
    run = first
    while True:
        try:
            if not run():
                return 0
        except UserError as error:  # the camera is still unplugged, the disk still full
            click.echo(f"error: {error}", err=True)
        click.echo(f"the exhibition restarts in {AGAIN_S:g} s", err=True)
        time.sleep(AGAIN_S)
        run = again
