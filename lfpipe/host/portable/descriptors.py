"""Open files: by name for libraries that take nothing else, read and written at a place. A name is the file's own: another file
may have it by the time that it is opened again.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

# Linux opens what could be a pipe or a terminal with care; Windows must not translate line ends.
CAREFUL = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_position = threading.Lock()


@contextlib.contextmanager
def _at(fd: int, offset: int) -> Iterator[None]:
    with _position:
        before = os.lseek(fd, 0, os.SEEK_CUR)
        os.lseek(fd, offset, os.SEEK_SET)
        try:
            yield
        finally:
            os.lseek(fd, before, os.SEEK_SET)


def read_at(fd: int, count: int, offset: int) -> bytes:
    """At most count bytes from there. Raises OSError."""
    with _at(fd, offset):
        return os.read(fd, count)


def write_at(fd: int, data: bytes | memoryview, offset: int) -> int:
    """Writes there; how many bytes were written. Raises OSError."""
    with _at(fd, offset):
        return os.write(fd, data)


def path_of(file: IO[bytes]) -> str:
    """The path that an open file was opened by."""
    return str(file.name)


def inherited(file: IO[bytes]) -> tuple[str, dict[str, Any]]:
    """The path by which a child process opens the file, and options for Popen."""
    return path_of(file), {}


def longest_name(folder: Path) -> int:
    """How many bytes a name in a folder may have."""
    return 255
