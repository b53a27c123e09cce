"""Where a session's ZeroMQ sockets meet: Unix sockets in its run directory, which its user alone may enter."""

from __future__ import annotations

import contextlib
import os
import socket as sockets
from pathlib import Path

import zmq

LONGEST = zmq.IPC_PATH_MAX_LEN


def too_long(run_dir: Path, name: str) -> int:
    """Characters of the path of a socket, where that is more than LONGEST; else 0."""
    length = len(str(run_dir / name))
    return length if length > LONGEST else 0


def bind(socket: zmq.Socket[bytes], run_dir: Path, name: str) -> None:
    """Makes a socket reachable under name. Raises zmq.ZMQError."""
    socket.bind(f"ipc://{run_dir / name}")
    (run_dir / name).chmod(0o600)


def connect(socket: zmq.Socket[bytes], run_dir: Path, name: str) -> None:
    """Connects to the socket of that name; where there is none, messages wait."""
    socket.connect(f"ipc://{run_dir / name}")


def shut_down(fd: int) -> None:
    """Ends a connection that libzmq has accepted.

    libzmq closes the descriptor itself, perhaps by now; what has its number then is no Unix socket, or one more client.
    """
    with contextlib.suppress(OSError), sockets.socket(fileno=os.dup(fd)) as connection:
        if connection.family == sockets.AF_UNIX:
            connection.shutdown(sockets.SHUT_RDWR)
