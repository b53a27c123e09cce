"""`lfpipe up --kiosk`: what is checked before an exhibition, and how it runs without a person."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import click

from lfpipe.errors import UserError

AGAIN_S = 2.0  # from a failed session to the next


def check_exhibition(code: str | None, visits: Path | None, display: str) -> None:
    """Raises UserError for an exhibition that nobody could see or end, or whose visits cannot be counted."""
    from lfpipe.config.session_options import check_code
    from lfpipe.files.safe_files import check_place, reason
    from lfpipe.render.visit_log import VisitLog

    if visits is not None:
        if code is None:
            raise UserError("--visits without --kiosk: an exhibition has visitors", "add --kiosk CODE, or leave it out")
        try:
            check_place(visits)
            VisitLog(visits)
        except OSError as error:
            raise UserError(f"--visits {visits}: {reason(error)}", "a file that you may write") from None
    if code is not None:
        check_code(code)
        if display not in ("window", "fullscreen"):
            raise UserError(f"--kiosk with --display {display}: an exhibition has a screen", "leave out one or the other")


def until_it_ends(first: Callable[[], int], again: Callable[[], int]) -> int:
    """Runs sessions, the first one and others, until one ends without failure: nobody is there to start the next."""
    run = first
    while True:
        try:
            if not run():
                return 0
        except UserError as error:  # the camera is still unplugged, the disk still full
            click.echo(f"error: {error}", err=True)
        click.echo(f"the exhibition starts again in {AGAIN_S:g} s", err=True)
        time.sleep(AGAIN_S)
        run = again
