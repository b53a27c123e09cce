"""Locks on open files that end with the process that holds them, however it ends (`flock`)."""

from __future__ import annotations

import fcntl


def lock(fd: int, shared: bool = False) -> bool:
    """Locks an open file without waiting; False where another process holds a lock that excludes this one. Raises OSError."""
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
