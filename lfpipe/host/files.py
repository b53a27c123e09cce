"""Files: what a path is, and open files by name.

`exists`, `is_file`, `is_dir` are False where a path cannot be examined. `Path.exists` and its like
raise OSError up to Python 3.13, for a folder that may not be searched, a name that is too long, a
network drive that has gone. To learn the reason, open the path.
"""

import os
import sys
from os.path import exists, isdir, isfile
from pathlib import Path
from typing import IO

__all__ = ["exists", "is_dir", "is_file"]
is_dir = isdir
is_file = isfile


# for files that a user names: opening waits for no other process and acquires no terminal
CAREFUL = os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
CREATING = CAREFUL | os.O_NOFOLLOW  # a link in the place of a new file is refused
_DESCRIPTORS = "/proc/self/fd" if sys.platform == "linux" else "/dev/fd"


def is_missing(path: str | os.PathLike[str]) -> bool:
    """Whether there is certainly nothing at path, not even a broken link."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        pass
    return False


def proc_fd_path(file: IO[bytes]) -> str:
    """A plain ASCII path to an open file, whatever its own name is, and even if it has none."""
    return f"{_DESCRIPTORS}/{file.fileno()}"


def reserve(path: Path) -> None:
    """Reserves disk space for all of a file, so that a map of it can be written.

    Raises OSError if it is full.
    """
    with path.open("r+b") as file:
        if hasattr(os, "posix_fallocate"):  # macOS has none: a full disk is a signal there
            os.posix_fallocate(file.fileno(), 0, os.fstat(file.fileno()).st_size)
