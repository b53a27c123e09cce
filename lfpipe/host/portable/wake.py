"""Wake-ups: datagrams over the loopback interface that carry the 8-byte seq of the published slot.

The reader owns a socket and writes its port to the file that is a FIFO on Linux. A restarted reader has another port, so a writer
reads the file before each wake. A reader wakes itself once, for slots published while it had no port. Wakes are hints: a false
one does no harm, because the ring has the truth. A full socket means that the reader has enough wakes.
"""

import contextlib
import os
import socket
import struct
from pathlib import Path

_SEQ = struct.Struct("@Q")
_HOST = "127.0.0.1"
BATCH = 512  # read at once


def make(path: Path) -> None:
    """Creates the file, readable by its owner only. Only the supervisor calls this."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))


class Wake:
    """Either end. reads: whether this is the only reader's end."""

    def __init__(self, path: Path, reads: bool = False) -> None:
        self._path, self._seen = path, (0, 0)
        self._port = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind((_HOST, 0))  # a writer too: its first datagram would open a port of every interface
        self.fd = self._socket.fileno()
        if reads:
            part = path.with_name(f".{path.name}.{os.getpid()}")
            part.write_text(str(self._socket.getsockname()[1]))
            part.replace(path)
            self.notify(0)

    def notify(self, seq: int) -> None:
        """Tells the reader that seq is published; does nothing if there is no reader yet."""
        with contextlib.suppress(OSError, ValueError):
            found = os.stat(self._path)  # noqa: PTH116  (once per frame and reader)
            if (seen := (found.st_ino, found.st_mtime_ns)) != self._seen:
                self._port, self._seen = int(self._path.read_text()), seen
            self._socket.sendto(_SEQ.pack(seq), (_HOST, self._port))

    def drain(self) -> int:
        """Reads all wakes (at most 512, the rest next time); returns the last seq, 0 if there was none."""
        last = 0
        with contextlib.suppress(OSError):  # none is left; on Windows also if a reader that this end once wrote to is gone
            for _ in range(BATCH):
                data = self._socket.recv(_SEQ.size)
                last = int(_SEQ.unpack(data)[0]) if len(data) == _SEQ.size else last
        return last

    def close(self) -> None:
        self._socket.close()
