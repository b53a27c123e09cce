"""A socket that is read at a limited rate. A flood of messages delays neither frames nor other clients."""

from collections.abc import Iterator

import attrs
import zmq

from lfpipe.transport.clock import MS_NS, now_ns

SLICE, SLICE_NS = 32, 20 * MS_NS  # messages per interval: at most 15 % of a core


@attrs.define
class ThrottledSocket:
    """Returns SLICE messages per SLICE_NS; the rest waits in the senders. ZeroMQ serves the clients in turn."""

    socket: zmq.Socket[bytes]
    _left: int = SLICE
    _until_ns: int = 0

    def messages(self) -> Iterator[tuple[list[bytes], int]]:
        """The messages that have arrived and may be read now, with the connection of each, as `ConnectionLimit` numbers them."""
        if now_ns() >= self._until_ns:
            self._left, self._until_ns = SLICE, now_ns() + SLICE_NS
        while self._left and self.socket.poll(0):
            self._left -= 1
            frames = self.socket.recv_multipart(copy=False)
            yield [frame.bytes for frame in frames], int(frames[0].get(zmq.SRCFD))

    def rest_ns(self) -> int:
        """Time until more messages may be read."""
        return 0 if self._left else max(0, self._until_ns - now_ns())
