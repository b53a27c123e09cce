"""Files: what a path is, open files by offset and by name, their owners.

`exists`, `is_file`, `is_dir` are False where a path cannot be examined. `Path.exists` and its like raise OSError up to Python
3.13, for a folder that may not be searched, a name that is too long, a network drive that has gone. Who needs the reason opens
the path.
"""

import importlib
import os
from os.path import exists, isdir, isfile
from pathlib import Path
from typing import IO

from lfpipe.host import WINDOWS

__all__ = ["exists", "is_dir", "is_file"]
is_dir, is_file = isdir, isfile


def flags(*names: str) -> int:
    """Those of `os.open` by name, as far as the system has them."""
    return sum(getattr(os, name, 0) for name in names)


# for files that a user names: opening waits for no other process and acquires no terminal; on Windows, line ends stay
CAREFUL = flags("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY")
_DESCRIPTORS = next((folder for folder in ("/proc/self/fd", "/dev/fd") if is_dir(folder)), "")


def is_missing(path: str | os.PathLike[str]) -> bool:
    """Whether there is certainly nothing at path, not even a broken link."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        pass
    return False


def read_at(fd: int, count: int, offset: int) -> bytes:
    """At most count bytes from that offset. Raises OSError."""
    if not WINDOWS:
        return os.pread(fd, count, offset)
    os.lseek(fd, offset, os.SEEK_SET)
    return os.read(fd, count)


def write_at(fd: int, data: bytes | memoryview, offset: int) -> int:
    """Writes at that offset; returns the number of bytes written. Raises OSError."""
    if not WINDOWS:
        return os.pwrite(fd, data, offset)
    os.lseek(fd, offset, os.SEEK_SET)
    return os.write(fd, data)


def path_of(file: IO[bytes]) -> str:
    """A plain ASCII path to an open file, whatever its own name is, and even if it has none; its own where a system has none."""
    return f"{_DESCRIPTORS}/{file.fileno()}" if _DESCRIPTORS else str(Path(file.name).absolute())


def longest_name(folder: Path) -> int:
    """The longest name in a folder, in bytes. Raises OSError."""
    return 255 if WINDOWS else os.pathconf(folder, "PC_NAME_MAX")


def user_id() -> int:
    """The numeric id of this process's user, as in `stat` of their files: 0 for everybody on Windows."""
    return 0 if WINDOWS else os.getuid()


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
