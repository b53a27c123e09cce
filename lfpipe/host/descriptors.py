"""Open files: by name for libraries that need one, read and written at an offset."""

import os
from pathlib import Path
from typing import IO

from lfpipe.host import WINDOWS
from lfpipe.host.paths import exists

# for files that a user names: opening waits for no other process and acquires no terminal; on Windows, line ends stay
CAREFUL = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"))
_DESCRIPTORS = next((folder for folder in ("/proc/self/fd", "/dev/fd") if exists(folder)), "")


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
