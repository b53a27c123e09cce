"""Wake-ups: notify the one reader of a ring that the slot of an 8-byte seq is published. Its
descriptor goes into the same zmq.Poller as sockets and sentinels. A wake-up may be lost while
others are pending: the reader takes the newest slot, so it misses nothing.
"""

import os
import select
import struct
from collections.abc import Sequence
from pathlib import Path

_SEQ = struct.Struct("@Q")


def make(path: Path) -> None:
    """Creates what both ends open, for its owner only. Only the supervisor calls this."""
    os.mkfifo(path, 0o600)


def readable(fds: Sequence[int], seconds: float) -> list[int]:
    """Sleeps until one of the descriptors can be read, or for seconds, to the microsecond; returns
    those that can.
    """
    return select.select(fds, (), (), seconds)[0]


class Wake:
    """Either end of a named FIFO. Both open it O_RDWR | O_NONBLOCK: no order of opening, no
    SIGPIPE, and it survives a restart of either side.
    """

    def __init__(self, path: Path) -> None:
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
            # 4 KiB at once, the rest next time
            data = os.read(self.fd, 512 * _SEQ.size)
        except BlockingIOError:
            return 0
        whole = len(data) // _SEQ.size * _SEQ.size
        return int(_SEQ.unpack_from(data, whole - _SEQ.size)[0]) if whole else 0

    def close(self) -> None:
        os.close(self.fd)
