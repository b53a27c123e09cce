"""The graphics hardware of this machine."""

from __future__ import annotations

import sys
from pathlib import Path


def has_gpu() -> bool:
    """Whether there is a device that renders; always true where the system does not say."""
    return sys.platform != "linux" or any(Path("/dev/dri").glob("renderD*"))


def has_desktop() -> bool:
    """Whether windows can be opened without a display server that is named in the environment: on macOS and Windows."""
    return sys.platform in ("darwin", "win32")
