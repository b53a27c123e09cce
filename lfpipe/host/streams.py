"""Standard output and standard error that survive a closed terminal, a reader that has ended, a full disk."""

import io
import os
import sys
from typing import Any


class _Forgiving(io.RawIOBase):
    """Writes to a descriptor; drops output that it does not accept instead of raising."""

    def __init__(self, fd: int) -> None:
        self._fd = fd

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._fd

    def isatty(self) -> bool:
        return os.isatty(self._fd)

    def write(self, data: Any) -> int:
        try:
            return os.write(self._fd, data)
        except OSError:  # EIO: the terminal is closed; EPIPE: the reader has ended; ENOSPC: the disk is full
            return len(data)


def open_standard_descriptors() -> None:
    """Opens /dev/null for those of 0, 1 and 2 that are closed: otherwise the next opened file would become standard error."""
    while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(fd, True)
    os.close(fd)


def protect(*names: str) -> None:
    """Makes the named ones of sys.stdout and sys.stderr drop output instead of raising. Redirected streams (a test's) stay."""
    open_standard_descriptors()
    for name in names:
        fd = {"stdout": 1, "stderr": 2}[name]
        stream = getattr(sys, name)
        if stream is None:  # it was closed when Python started
            encoding, errors = "utf-8", "backslashreplace"
        elif isinstance(stream, io.TextIOWrapper) and _descriptor(stream) == fd:
            stream.flush()
            encoding, errors = stream.encoding, stream.errors or "strict"
        else:
            continue
        buffered = io.BufferedWriter(_Forgiving(fd))
        lines = name == "stderr" or os.isatty(fd)
        setattr(sys, name, io.TextIOWrapper(buffered, encoding, errors, line_buffering=lines))


def _descriptor(stream: io.TextIOWrapper) -> int:
    try:
        return stream.fileno()
    except (OSError, ValueError):
        return -1
