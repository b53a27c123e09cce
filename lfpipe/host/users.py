"""Users of this machine."""

import importlib
import os
from pathlib import Path

from lfpipe.host import WINDOWS


def user_id() -> int:
    """The numeric id of this process's user, as in `stat` of their files: 0 for everybody on Windows."""
    return 0 if WINDOWS else os.getuid()


def user_word() -> str:
    """The user, as a part of names that must differ between users."""
    return str(user_id())


def user_name(number: int) -> str:
    """The name of a user, or the number if there is none."""
    try:
        return str(importlib.import_module("pwd").getpwuid(number).pw_name)
    except (ImportError, KeyError):
        return str(number)


def runtime_dir() -> Path:
    """The folder for a user's runtime files if XDG_RUNTIME_DIR is not set."""
    if not WINDOWS:
        return Path("/tmp")  # short: the path of a socket has at most 107 bytes, on macOS 103
    import platformdirs

    return Path(platformdirs.user_runtime_dir("lfpipe", appauthor=False, ensure_exists=True))
