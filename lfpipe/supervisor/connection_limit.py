"""Bounds the connections to a session's sockets: libzmq aborts the process if no file descriptor is left for a new connection.

Connections beyond the limit are closed at once; ZeroMQ clients retry by themselves until there is room.
"""

import contextlib
import os
import socket
from collections.abc import Callable, Iterable

import zmq
from zmq.utils.monitor import parse_monitor_message

from lfpipe.host.limits import OPEN_FILES, allowed_files

MOST_CONNECTIONS, FEWEST_CONNECTIONS = 512, 24  # the stages need two each
HANDSHAKE_MS = 2000  # a connection that is silent for longer is closed


class ConnectionLimit:
    """Counts the connections of sockets, from libzmq's events. Create it before they are bound. sockets: for a poller. log: for
    people."""

    def __init__(self, sockets: Iterable[zmq.Socket[bytes]], log: Callable[[str], None]) -> None:
        self._watched, self._log = list(sockets), log
        self._limit = min(MOST_CONNECTIONS, max(FEWEST_CONNECTIONS, (allowed_files() - OPEN_FILES) // 2))
        self._open: set[int] = set()  # file descriptors of connections, from the events
        self._refusing = False
        for each in self._watched:
            each.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        self.sockets = [each.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED) for each in self._watched]

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
        for each in self._watched:
            each.disable_monitor()
