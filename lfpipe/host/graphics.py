"""The graphics hardware of this machine."""

import sys
from pathlib import Path


def has_gpu() -> bool:
    """Whether there is a rendering device; true if the system cannot report it."""
    return sys.platform != "linux" or any(Path("/dev/dri").glob("renderD*"))


def has_desktop() -> bool:
    """Whether windows need no display server named in the environment: on macOS and Windows."""
    return sys.platform in ("darwin", "win32")
