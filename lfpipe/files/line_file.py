"""A file that grows by whole lines: neither a full disk nor the death of its writer leaves half a line in it."""

from __future__ import annotations

import os
from pathlib import Path

from lfpipe.files.safe_files import PRIVATE, check_regular
from lfpipe.host.descriptors import CAREFUL, read_at

LONGEST_LINE = 1 << 16  # bytes; how far back the last line's end is looked for


class LineFile:
    """Appends lines with one write each. Half a line that a killed writer may have left is cut off."""

    def __init__(self, path: Path) -> None:
        """Makes the file where there is none, for its owner alone. Raises OSError, also where path is no file."""
        check_regular(path)
        self._fd = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | CAREFUL, PRIVATE)
        size = os.fstat(self._fd).st_size
        tail = read_at(self._fd, min(size, LONGEST_LINE), max(0, size - LONGEST_LINE)) if size else b""
        if tail and not tail.endswith(b"\n"):
            os.ftruncate(self._fd, size - len(tail) + tail.rfind(b"\n") + 1)

    def append(self, line: bytes) -> None:
        """Adds line, which ends with a newline. Raises OSError where it does not fit; the file then ends with the one before."""
        written = 0
        try:
            while written < len(line):  # a second write, where there is one, is to tell why the first was cut short
                written += os.write(self._fd, line[written:])
        except OSError:
            if written:
                os.ftruncate(self._fd, os.fstat(self._fd).st_size - written)
            raise

    def close(self) -> None:
        os.close(self._fd)
