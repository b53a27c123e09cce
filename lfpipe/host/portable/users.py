"""Users of this machine."""

import os
from pathlib import Path

import platformdirs


def user_id() -> int:
    """The numeric id of this process's user, as in `stat` of their files: 0 for everybody on Windows."""
    return os.getuid() if hasattr(os, "getuid") else 0


def user_word() -> str:
    """The user, as a part of names that must differ between users and between implementations of `host`."""
    return f"p{user_id()}"


def user_name(number: int) -> str:
    """A name for a user."""
    return str(number)


def runtime_dir() -> Path:
    """The folder for a user's runtime files if XDG_RUNTIME_DIR is not set."""
    return Path(platformdirs.user_runtime_dir("lfpipe", appauthor=False, ensure_exists=True))
