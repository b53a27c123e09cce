"""Wake-ups: one named FIFO per (ring, reader) that carries the 8-byte seq of the published slot.

Both ends open it O_RDWR | O_NONBLOCK: no order of opening, no SIGPIPE, it survives a restart of either side, and its descriptor
goes into the same zmq.Poller as sockets and sentinels. A full FIFO means that the reader has enough wakes.
"""

import contextlib
import os
import struct
from pathlib import Path

_SEQ = struct.Struct("@Q")
BATCH = 512 * _SEQ.size  # read at once: os.read allocates a buffer of the full size


def make(path: Path) -> None:
    """Creates the FIFO, readable by its owner only. Only the supervisor calls this."""
    os.mkfifo(path, 0o600)


class Wake:
    """Either end of one FIFO. reads: whether this is the only reader's end."""

    def __init__(self, path: Path, reads: bool = False) -> None:
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK)

    def notify(self, seq: int) -> None:
        """Tells the reader that seq is published."""
        with contextlib.suppress(BlockingIOError):
            os.write(self.fd, _SEQ.pack(seq))

    def drain(self) -> int:
        """Reads all wakes (at most 512, the rest next time); returns the last seq, 0 if there was none."""
        try:
            data = os.read(self.fd, BATCH)
        except BlockingIOError:
            return 0
        whole = len(data) // _SEQ.size * _SEQ.size
        return int(_SEQ.unpack_from(data, whole - _SEQ.size)[0]) if whole else 0

    def close(self) -> None:
        os.close(self.fd)
