"""How much is taken from a socket that anybody may shout at, so that neither a frame nor another client waits for a flood."""

from __future__ import annotations

from collections.abc import Iterator

import attrs
import zmq

from lfpipe.transport.clock import MS_NS, now_ns

SLICE, SLICE_NS = 32, 20 * MS_NS  # messages in so much time: 15 % of a core at the most


@attrs.define
class Intake:
    """One socket, SLICE messages in SLICE_NS; the rest waits in the senders. ZeroMQ takes one of each client in turn."""

    socket: zmq.Socket[bytes]
    _left: int = SLICE
    _until_ns: int = 0

    def messages(self) -> Iterator[list[bytes]]:
        """Those that are there and may be taken now."""
        if now_ns() >= self._until_ns:
            self._left, self._until_ns = SLICE, now_ns() + SLICE_NS
        while self._left and self.socket.poll(0):
            self._left -= 1
            yield self.socket.recv_multipart()

    def rest_ns(self) -> int:
        """How long it will take no more."""
        return 0 if self._left else max(0, self._until_ns - now_ns())
