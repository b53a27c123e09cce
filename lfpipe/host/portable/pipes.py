"""Reads the output of a child process without waiting: in a thread, because some systems cannot poll a pipe."""

import os
import queue
import threading
from typing import IO

CHUNKS = 16  # chunks of 64 KiB in the queue; then the child waits


class PipeReader:
    """stream: the child's end of a pipe, closed by this object."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._next = stream, None  # type: tuple[IO[bytes], bytes | None]
        self._chunks: queue.Queue[bytes] = queue.Queue(CHUNKS)
        self._closed = False
        threading.Thread(target=self._run, name="pipe", daemon=True).start()

    def _run(self) -> None:
        data = b"x"
        while data and not self._closed:
            try:
                data = os.read(self._stream.fileno(), 1 << 16)
            except (OSError, ValueError):
                data = b""
            while not self._closed:
                try:
                    self._chunks.put(data, timeout=0.1)
                    break
                except queue.Full:
                    continue
        self._stream.close()

    @property
    def fds(self) -> list[int]:
        """None: a poller returns after its timeout, and `read` then reports what is available."""
        return []

    def wait(self, timeout_s: float) -> bool:
        """Whether there is something to read, or the end, within timeout_s."""
        if self._next is None:
            try:
                self._next = self._chunks.get(timeout=timeout_s)
            except queue.Empty:
                return False
        return True

    def read(self) -> bytes | None:
        """At most 64 KiB; empty at the end, None if nothing is available yet."""
        if not self.wait(0.001):
            return None
        data, self._next = self._next, None
        if not data:
            self._next = b""  # the end stays
        return data

    def close(self) -> None:
        """Call after the child has ended, or to stop reading. The thread closes the pipe."""
        self._closed = True
