"""Users of this machine."""

from __future__ import annotations

import os
import pwd
from pathlib import Path


def user_id() -> int:
    """The number of the user that this process runs as, as `stat` gives it for their files."""
    return os.getuid()


def user_word() -> str:
    """The user, as part of a name that others must not share."""
    return str(os.getuid())


def user_name(number: int) -> str:
    """The name of a user, or the number where it has none."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)


def runtime_dir() -> Path:
    """Where a user's programs keep what lives as long as they, where XDG_RUNTIME_DIR does not say."""
    return Path("/tmp")
