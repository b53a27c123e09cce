"""Wake-ups: what tells the one reader of a ring that the slot of an 8-byte seq is published. Its descriptor goes into the same
zmq.Poller as sockets and sentinels. A wake that is not taken yet is enough: the ring has the truth.
"""

import contextlib
import os
import select
import socket
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfpipe.host import PORTABLE

_SEQ = struct.Struct("@Q")
MOST = 512  # wakes read at once; the rest next time
_HOST = "127.0.0.1"


def make(path: Path) -> None:
    """Creates what both ends open, for its owner only. Only the supervisor calls this."""
    if PORTABLE:
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
    else:
        os.mkfifo(path, 0o600)


def readable(fds: Sequence[int], seconds: float) -> list[int]:
    """Sleeps until one of the descriptors can be read, or for seconds, to the microsecond; returns those that can."""
    return select.select(fds, (), (), seconds)[0]


class FifoWake:
    """Either end of a named FIFO. Both open it O_RDWR | O_NONBLOCK: no order of opening, no SIGPIPE, and it survives a restart of
    either side. reads: whether this is the only reader's end."""

    def __init__(self, path: Path, reads: bool = False) -> None:
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK)

    def notify(self, seq: int) -> None:
        """Wakes the reader for seq."""
        try:
            os.write(self.fd, _SEQ.pack(seq))
        except BlockingIOError:
            return  # full: the reader is awake

    def drain(self) -> int:
        """Reads all wakes, at most MOST; returns the last seq, 0 if there was none."""
        try:
            data = os.read(self.fd, MOST * _SEQ.size)
        except BlockingIOError:
            return 0
        whole = len(data) // _SEQ.size * _SEQ.size
        return int(_SEQ.unpack_from(data, whole - _SEQ.size)[0]) if whole else 0

    def close(self) -> None:
        os.close(self.fd)


class SocketWake:
    """Either end of datagrams over the loopback interface. The reader owns a socket and writes its port to the file; a restarted
    one has another port, so a writer looks at the file before each wake. A reader wakes itself once, for slots published while
    it had no port."""

    def __init__(self, path: Path, reads: bool = False) -> None:
        self._path, self._seen = path, (0, 0)
        self._port = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind((_HOST, 0))  # a writer too: its first datagram would open a port of every interface
        self.fd = self._socket.fileno()
        if reads:
            new = path.with_name(f".{path.name}.{os.getpid()}")
            new.write_text(str(self._socket.getsockname()[1]))
            new.replace(path)
            self.notify(0)

    def notify(self, seq: int) -> None:
        """Wakes the reader for seq; does nothing if there is no reader yet."""
        with contextlib.suppress(OSError, ValueError):
            entry = os.stat(self._path)  # noqa: PTH116  (once per frame and reader)
            if (seen := (entry.st_ino, entry.st_mtime_ns)) != self._seen:
                self._port, self._seen = int(self._path.read_text()), seen
            self._socket.sendto(_SEQ.pack(seq), (_HOST, self._port))

    def drain(self) -> int:
        """Reads all wakes, at most MOST; returns the last seq, 0 if there was none."""
        last = 0
        with contextlib.suppress(OSError):  # none is left
            for _ in range(MOST):
                data = self._socket.recv(_SEQ.size)
                last = int(_SEQ.unpack(data)[0]) if len(data) == _SEQ.size else last  # anybody may send
        return last

    def close(self) -> None:
        self._socket.close()


if TYPE_CHECKING:  # a type checker wants one class
    Wake = FifoWake
else:
    Wake = SocketWake if PORTABLE else FifoWake
