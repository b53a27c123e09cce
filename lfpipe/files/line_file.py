"""A file that grows by whole lines. Neither a full disk nor a killed writer leaves a partial line."""

import os
from pathlib import Path

from lfpipe.files.safe_files import PRIVATE, check_regular
from lfpipe.host.files import CAREFUL, read_at

LONGEST_LINE = 1 << 16  # bytes; limit of the search for the end of the last line


class LineFile:
    """Appends lines with one write each. A partial line left by a killed writer is cut off."""

    def __init__(self, path: Path) -> None:
        """Creates the file, private to its owner, if it does not exist. Raises OSError, also if path is not a file."""
        check_regular(path)
        self._fd = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | CAREFUL, PRIVATE)
        size = os.fstat(self._fd).st_size
        tail = read_at(self._fd, min(size, LONGEST_LINE), max(0, size - LONGEST_LINE)) if size else b""
        if tail and not tail.endswith(b"\n"):
            os.ftruncate(self._fd, size - len(tail) + tail.rfind(b"\n") + 1)

    def append(self, line: bytes) -> None:
        """Appends line, which ends with a newline. Raises OSError if it does not fit; the file then ends with the last line."""
        written = 0
        try:
            while written < len(line):  # after a short write, a second one raises the reason
                written += os.write(self._fd, line[written:])
        except OSError:
            if written:
                os.ftruncate(self._fd, os.fstat(self._fd).st_size - written)
            raise

    def close(self) -> None:
        os.close(self._fd)
