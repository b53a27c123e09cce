"""Sockets with a path."""

import os
import socket
import struct
from pathlib import Path


def listening(path: Path) -> socket.socket:
    """A socket that only this user may connect to, not blocking. Raises OSError."""
    listener = socket.socket(socket.AF_UNIX)
    try:
        listener.bind(os.fspath(path))
        path.chmod(0o600)
        listener.listen(socket.SOMAXCONN)
        listener.setblocking(False)
    except BaseException:
        listener.close()
        raise
    return listener


def peer_pid(connection: socket.socket) -> int:
    """The process at the other end; 0 if the system does not know."""
    if not hasattr(socket, "SO_PEERCRED"):
        return 0
    size = struct.calcsize("3i")  # struct ucred: pid, uid, gid
    known = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
    return int(struct.unpack("3i", known)[0])
