"""What the control server knows of its clients' connections, and a limit on the rate at which their messages are read."""

from collections.abc import Iterator

import attrs
import zmq
from zmq.utils.monitor import parse_monitor_message

from lfpipe.transport.clock import MS_NS, now_ns

HANDSHAKE_MS = 2000  # a connection that is silent for longer is closed
SLICE, SLICE_NS = 32, 20 * MS_NS  # messages per interval: at most 15 % of a core


class Connections:
    """The connections of a socket, from libzmq's events. Create it before the socket is bound. events: for a poller. open: file
    descriptors, as ZMQ_SRCFD of a message names them."""

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self.open: set[int] = set()
        self._socket = socket
        socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        self.events = socket.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)

    def update(self) -> None:
        """Processes the events since the last call."""
        while self.events.poll(0):
            event = parse_monitor_message(self.events.recv_multipart())
            (self.open.add if event["event"] == zmq.EVENT_ACCEPTED else self.open.discard)(event["value"])

    def close(self) -> None:
        """Ends the events; does not close the socket."""
        self._socket.disable_monitor()


@attrs.define
class ThrottledSocket:
    """Returns SLICE messages per SLICE_NS, so a flood delays neither frames nor other clients; the rest waits in the senders.
    ZeroMQ serves the clients in turn."""

    socket: zmq.Socket[bytes]
    _left: int = SLICE
    _until_ns: int = 0

    def messages(self) -> Iterator[tuple[list[bytes], int]]:
        """The messages that have arrived and may be read now, with the file descriptor of each one's connection."""
        if now_ns() >= self._until_ns:
            self._left, self._until_ns = SLICE, now_ns() + SLICE_NS
        while self._left and self.socket.poll(0):
            self._left -= 1
            frames = self.socket.recv_multipart(copy=False)
            yield [frame.bytes for frame in frames], int(frames[0].get(zmq.SRCFD))

    def rest_ns(self) -> int:
        """Time until more messages may be read."""
        return 0 if self._left else max(0, self._until_ns - now_ns())
