"""Endpoints of a session's ZeroMQ sockets: Unix sockets in its run directory, which only its user may enter."""

import contextlib
import os
import socket as sockets
from pathlib import Path

import zmq

LONGEST = zmq.IPC_PATH_MAX_LEN


def too_long(run_dir: Path, name: str) -> int:
    """Length of a socket's path if it exceeds LONGEST; else 0."""
    length = len(str(run_dir / name))
    return length if length > LONGEST else 0


def bind(socket: zmq.Socket[bytes], run_dir: Path, name: str) -> None:
    """Makes a socket reachable under name. Raises zmq.ZMQError."""
    socket.bind(f"ipc://{run_dir / name}")
    (run_dir / name).chmod(0o600)


def connect(socket: zmq.Socket[bytes], run_dir: Path, name: str) -> None:
    """Connects to the socket of that name; if there is none, messages wait."""
    socket.connect(f"ipc://{run_dir / name}")


def shut_down(fd: int) -> None:
    """Ends a connection that libzmq has accepted.

    libzmq closes the descriptor itself, perhaps already; then its number belongs to something else than a Unix socket, or to
    another client.
    """
    with contextlib.suppress(OSError), sockets.socket(fileno=os.dup(fd)) as connection:
        if connection.family.name == "AF_UNIX":
            connection.shutdown(sockets.SHUT_RDWR)
