"""Everything that differs between operating systems, behind plain functions.

The modules here are Linux's. Those in `portable` have the same names and functions and use only what Windows, macOS and Linux
have in common. They replace Linux's on every other system, and on Linux if LFPIPE_HOST=portable is set. Only this module chooses:
`lfpipe.host.wake` is then the module in `portable`. A module without a counterpart there serves all systems.
"""

import os
import sys

from lfpipe.errors import UserError

_ASKED = os.environ.get("LFPIPE_HOST", "")
PORTABLE = _ASKED == "portable" or sys.platform != "linux"
if PORTABLE:
    __path__.insert(0, os.path.join(__path__[0], "portable"))  # noqa: PTH118  (the path of a package is text)


def check_choice() -> None:
    """Raises UserError if LFPIPE_HOST names no implementation."""
    if _ASKED not in ("", "portable"):
        raise UserError(f"LFPIPE_HOST={_ASKED!r} is not known", "set it to portable, or unset it")
