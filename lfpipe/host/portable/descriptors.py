"""Open files: by name for libraries that need one, read and written at an offset. The name is the file's own: another file may
have taken it before it is opened again.
"""

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

# on Linux, safe for pipes and terminals; on Windows, no translation of line ends
CAREFUL = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_BY_NUMBER = "/dev/fd/"
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
    """At most count bytes from that offset. Raises OSError."""
    with _at(fd, offset):
        return os.read(fd, count)


def write_at(fd: int, data: bytes | memoryview, offset: int) -> int:
    """Writes at that offset; returns the number of bytes written. Raises OSError."""
    with _at(fd, offset):
        return os.write(fd, data)


def path_of(file: IO[bytes]) -> str:
    """The absolute path by which the file was opened: a relative one may look like an address (concat:x.avi).

    For a name that is not UTF-8, on which libraries crash and which only Linux has: the path of the descriptor.
    """
    path = str(Path(file.name).absolute())
    try:
        path.encode()
    except UnicodeEncodeError:
        return f"{_BY_NUMBER}{file.fileno()}"
    return path


def inherited(file: IO[bytes]) -> tuple[str, dict[str, Any]]:
    """The path by which a child process opens the file, and options for Popen."""
    path = path_of(file)
    return path, {"pass_fds": (file.fileno(),)} if path.startswith(_BY_NUMBER) else {}


def longest_name(folder: Path) -> int:
    """The longest name in a folder, in bytes."""
    return 255
