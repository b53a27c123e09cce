"""Locks on open files; the kernel drops them when their process ends (`flock`)."""

from __future__ import annotations

import fcntl


def wait_and_lock(fd: int) -> None:
    """Locks an open file for this process alone, as soon as no other process holds a lock on it. Raises OSError."""
    fcntl.flock(fd, fcntl.LOCK_EX)


def lock(fd: int, shared: bool = False) -> bool:
    """Locks an open file without waiting; False if another process holds a conflicting lock. Raises OSError."""
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
