"""Open files: by name for libraries that take nothing else, handed to child processes, read and written at a place."""

from __future__ import annotations

import os
from pathlib import Path
from typing import IO, Any

# For files that somebody names: opening waits for no other process, and makes no terminal this process's own.
CAREFUL = os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
read_at, write_at = os.pread, os.pwrite


def path_of(file: IO[bytes]) -> str:
    """A path of plain ASCII to an open file, whatever its own name is, and even where it has none."""
    return f"/proc/self/fd/{file.fileno()}"


def inherited(file: IO[bytes]) -> tuple[str, dict[str, Any]]:
    """The path by which a child process opens the file, and options for Popen."""
    return path_of(file), {"pass_fds": (file.fileno(),)}


def longest_name(folder: Path) -> int:
    """How many bytes a name in a folder may have. Raises OSError."""
    return os.pathconf(folder, "PC_NAME_MAX")
