"""Users of this machine."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def user_id() -> int:
    """The number of the user that this process runs as, as `stat` gives it for their files: 0 for everybody on Windows."""
    return os.getuid() if hasattr(os, "getuid") else 0


def user_word() -> str:
    """The user, as part of a name that others must not share: nor sessions of the other implementation of `host`."""
    return f"p{user_id()}"


def user_name(number: int) -> str:
    """A word for a user."""
    return str(number)


def runtime_dir() -> Path:
    """Where a user's programs keep what lives as long as they, where XDG_RUNTIME_DIR does not say."""
    return Path(platformdirs.user_runtime_dir("lfpipe", appauthor=False, ensure_exists=True))
