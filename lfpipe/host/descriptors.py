"""Open files: by name for libraries that need one, inherited by child processes, read and written at an offset."""

import os
from pathlib import Path
from typing import IO, Any

# for files that a user names: opening waits for no other process and acquires no terminal
CAREFUL = os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
read_at, write_at = os.pread, os.pwrite


def path_of(file: IO[bytes]) -> str:
    """A plain ASCII path to an open file, whatever its own name is, and even if it has none."""
    return f"/proc/self/fd/{file.fileno()}"


def inherited(file: IO[bytes]) -> tuple[str, dict[str, Any]]:
    """The path by which a child process opens the file, and options for Popen."""
    return path_of(file), {"pass_fds": (file.fileno(),)}


def longest_name(folder: Path) -> int:
    """The longest name in a folder, in bytes. Raises OSError."""
    return os.pathconf(folder, "PC_NAME_MAX")
