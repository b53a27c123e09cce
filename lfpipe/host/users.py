"""Users of this machine."""

from __future__ import annotations

import os
import pwd


def user_id() -> int:
    """The number of the user that this process runs as."""
    return os.getuid()


def user_name(number: int) -> str:
    """The name of a user, or the number where it has none."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)
