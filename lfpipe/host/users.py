"""Users of this machine."""

import os
import pwd
from pathlib import Path


def user_id() -> int:
    """The numeric id of this process's user, as in `stat` of their files."""
    return os.getuid()


def user_word() -> str:
    """The user, as a part of names that must differ between users."""
    return str(os.getuid())


def user_name(number: int) -> str:
    """The name of a user, or the number if there is none."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)


def runtime_dir() -> Path:
    """The folder for a user's runtime files if XDG_RUNTIME_DIR is not set."""
    return Path("/tmp")
