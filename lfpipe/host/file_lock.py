"""Locks on open files; the kernel drops them when their process ends (`flock`)."""

from __future__ import annotations

import fcntl


def lock(fd: int, shared: bool = False) -> bool:
    """Locks an open file without waiting; False if another process holds a conflicting lock. Raises OSError."""
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
