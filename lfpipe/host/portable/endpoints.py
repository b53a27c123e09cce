"""Where a session's ZeroMQ sockets meet: ports of the loopback interface, which every user of the machine can reach.

A file in the run directory, for its user alone, holds the port and the socket's public key of CurveZMQ (rfc.zeromq.org/spec/26).
That key is never sent: a client shows in the handshake that it has it, and one that has not is dropped before its first message.
So the file is the token. What follows is encrypted.
"""

from __future__ import annotations

import contextlib
import os
import socket as sockets
from pathlib import Path

import zmq

LONGEST = 4096
_NOBODY = "tcp://127.0.0.1:1"  # where no session is: messages wait, as they would for a Unix socket that is missing


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
    """Connects to the socket of that name; where there is none, messages wait."""
    try:
        where, key = (run_dir / name).read_bytes().split(b"\n")
        socket.curve_serverkey = key
    except (OSError, ValueError, zmq.ZMQError):
        where, socket.curve_serverkey = _NOBODY.encode(), zmq.curve_keypair()[0]
    socket.curve_publickey, socket.curve_secretkey = zmq.curve_keypair()
    socket.connect(where.decode())


def shut_down(fd: int) -> None:
    """Ends a connection that libzmq has accepted.

    libzmq closes the descriptor itself, perhaps by now; what has its number then is no stream, or one more client.
    """
    with contextlib.suppress(OSError):
        connection = sockets.socket(fileno=fd)  # not a copy: a Windows socket has none
        try:
            if connection.type == sockets.SOCK_STREAM:
                connection.shutdown(sockets.SHUT_RDWR)
        finally:
            connection.detach()
