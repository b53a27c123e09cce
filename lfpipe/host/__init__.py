"""Everything that differs between operating systems, behind plain functions.

Two things have a second form, for systems without Linux's own: wake-ups and cameras. PORTABLE chooses it; LFPIPE_HOST=portable
does so on Linux too, for tests.
"""

import os
import sys

from lfpipe.errors import UserError

_ASKED = os.environ.get("LFPIPE_HOST", "")
PORTABLE = _ASKED == "portable" or sys.platform != "linux"
WINDOWS = os.name == "nt"  # a name of its own: a type checker takes sys.platform for its own system


def check_choice() -> None:
    """Raises UserError if LFPIPE_HOST names no implementation."""
    if _ASKED not in ("", "portable"):
        raise UserError(f"LFPIPE_HOST={_ASKED!r} is not known", "set it to portable, or unset it")
