"""Reads the output of a child process without waiting; on Windows from Python 3.12 on."""

import os
from multiprocessing import connection
from typing import IO

from lfpipe.host import WINDOWS


class PipeReader:
    """stream: the child's end of a pipe, closed by this object."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        os.set_blocking(stream.fileno(), False)

    @property
    def fds(self) -> list[int]:
        """Descriptors for a poller, readable when there is something to read or the end; none on Windows."""
        return [] if WINDOWS or self._stream.closed else [self._stream.fileno()]

    def wait(self, timeout_s: float) -> bool:
        """Whether there is something to read, or the end, within timeout_s."""
        return bool(connection.wait([self._stream.fileno()], timeout_s))

    def read(self) -> bytes | None:
        """At most 64 KiB; empty at the end, None if nothing is available yet."""
        try:
            return os.read(self._stream.fileno(), 1 << 16)
        except BlockingIOError:
            return None

    def close(self) -> None:
        """Call after the child has ended, or to stop reading."""
        self._stream.close()
