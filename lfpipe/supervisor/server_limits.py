"""Bounds what clients can ask of a session: the number of their connections, and the rate at which their messages are read."""

import contextlib
import os
import socket
from collections.abc import Callable, Iterable, Iterator

import attrs
import zmq
from zmq.utils.monitor import parse_monitor_message

from lfpipe.host.limits import OPEN_FILES, allowed_files
from lfpipe.transport.clock import MS_NS, now_ns

MOST_CONNECTIONS, FEWEST_CONNECTIONS = 512, 24  # the stages need two each
HANDSHAKE_MS = 2000  # a connection that is silent for longer is closed
SLICE, SLICE_NS = 32, 20 * MS_NS  # messages per interval: at most 15 % of a core


class ConnectionLimit:
    """Counts the connections of sockets, from libzmq's events, which aborts the process if no file descriptor is left for a new
    one. Create it before they are bound. sockets: for a poller. log: for people.

    Connections beyond the limit are closed at once; ZeroMQ clients retry by themselves until there is room.
    """

    def __init__(self, sockets: Iterable[zmq.Socket[bytes]], log: Callable[[str], None]) -> None:
        self._watched, self._log = list(sockets), log
        self._limit = min(MOST_CONNECTIONS, max(FEWEST_CONNECTIONS, (allowed_files() - OPEN_FILES) // 2))
        self._open: set[int] = set()  # file descriptors of connections, from the events
        self._refusing = False
        for watched in self._watched:
            watched.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        self.sockets = [watched.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED) for watched in self._watched]

    def serve(self) -> set[int]:
        """Processes the events since the last call; returns the connections that have ended."""
        gone: set[int] = set()
        for monitor in self.sockets:
            while monitor.poll(0):
                event = parse_monitor_message(monitor.recv_multipart())
                if event["event"] == zmq.EVENT_DISCONNECTED:
                    self._open.discard(event["value"])
                    gone.add(event["value"])
                elif len(self._open) < self._limit:
                    self._open.add(event["value"])
                    self._refusing = False
                else:
                    self._refuse(event["value"])
        return gone

    def _refuse(self, fd: int) -> None:
        if not self._refusing:
            self._refusing = True
            self._log(f"{self._limit} programs are connected to the session; further ones are refused until some disconnect")
        # libzmq closes the descriptor itself, perhaps already; its number then belongs to something else, or to another client
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(fd)) as connection:
            if connection.family.name == "AF_UNIX":
                connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Stops counting; does not close the sockets."""
        for watched in self._watched:
            watched.disable_monitor()


@attrs.define
class ThrottledSocket:
    """Returns SLICE messages per SLICE_NS, so a flood delays neither frames nor other clients; the rest waits in the senders.
    ZeroMQ serves the clients in turn."""

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
