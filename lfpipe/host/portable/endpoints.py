"""Endpoints of a session's ZeroMQ sockets: ports of the loopback interface, which every user of the machine can reach.

A file in the run directory, for its user alone, holds the port and the socket's public key of CurveZMQ (rfc.zeromq.org/spec/26).
That key is never sent: a client proves in the handshake that it has the key; one without it is dropped before its first message.
So the file is the token. All messages are encrypted.
"""

import contextlib
import os
import socket as sockets
from pathlib import Path

import zmq

LONGEST = 4096
_NOBODY = "tcp://127.0.0.1:1"  # no session there: messages wait, as for a missing Unix socket


def too_long(run_dir: Path, name: str) -> int:
    """0: a port has no path."""
    return 0


def bind(socket: zmq.Socket[bytes], run_dir: Path, name: str) -> None:
    """Makes a socket reachable under name. Raises zmq.ZMQError, OSError."""
    public, secret = zmq.curve_keypair()
    socket.curve_secretkey, socket.curve_server = secret, True
    socket.bind("tcp://127.0.0.1:*")
    where = socket.getsockopt(zmq.LAST_ENDPOINT)
    assert isinstance(where, bytes)
    part = run_dir / f".{name}.{os.getpid()}"
    with os.fdopen(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "wb") as file:
        file.write(where.rstrip(b"\0") + b"\n" + public)
    part.replace(run_dir / name)


def connect(socket: zmq.Socket[bytes], run_dir: Path, name: str) -> None:
    """Connects to the socket of that name; if there is none, messages wait."""
    try:
        where, key = (run_dir / name).read_bytes().split(b"\n")
        socket.curve_serverkey = key
    except (OSError, ValueError, zmq.ZMQError):
        where, socket.curve_serverkey = _NOBODY.encode(), zmq.curve_keypair()[0]
    socket.curve_publickey, socket.curve_secretkey = zmq.curve_keypair()
    socket.connect(where.decode())


def shut_down(fd: int) -> None:
    """Ends a connection that libzmq has accepted.

    libzmq closes the descriptor itself, perhaps already; then its number belongs to something else than a stream, or to another
    client.
    """
    with contextlib.suppress(OSError):
        connection = sockets.socket(fileno=fd)  # not a copy: a Windows socket has none
        try:
            if connection.type == sockets.SOCK_STREAM:
                connection.shutdown(sockets.SHUT_RDWR)
        finally:
            connection.detach()
