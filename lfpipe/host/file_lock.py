"""Locks on files; the kernel drops them when their process ends (`flock`)."""

import contextlib
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

_SAFE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
PAUSE_S, _REPORT_S = 0.01, 1.0  # between attempts; between reports to a person


def lock_open(fd: int, shared: bool = False) -> bool:
    """Locks an open file without waiting; False if another process holds a conflicting lock.

    Raises OSError.
    """
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class Lock:
    """A lock that this process holds on the file at path.

    fd: open and locked; closed by this object.
    """

    def __init__(self, path: Path, fd: int) -> None:
        self._path = path
        self._fd = fd

    def in_place(self) -> bool:
        """Whether the locked file is still at its path. True if the path cannot be examined."""
        try:
            return os.path.samestat(self._path.lstat(), os.fstat(self._fd))
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            return True

    def release(self) -> None:
        """Releases the lock; may be called again."""
        fd = self._fd
        self._fd = -1
        if fd >= 0:
            os.close(fd)


def take(path: Path) -> Lock | None:
    """Locks the file at path, created if missing, without waiting; None if another process holds a
    lock. Raises OSError.
    """
    fd = os.open(path, os.O_RDWR | os.O_CREAT | _SAFE, 0o600)
    if lock_open(fd):
        return Lock(path, fd)
    os.close(fd)
    return None


@contextlib.contextmanager
def waited_for(path: Path, waiting: Callable[[], None]) -> Iterator[None]:
    """Holds the lock of a file, created if missing; waits until no other process holds one.
    waiting: called once a second meanwhile. Raises OSError.
    """
    report_s = time.monotonic() + _REPORT_S
    while (lock := take(path)) is None:
        time.sleep(PAUSE_S)
        if time.monotonic() >= report_s:
            report_s += _REPORT_S
            waiting()
    try:
        yield
    finally:
        lock.release()


def is_held(path: Path) -> bool:
    """Whether a process holds an exclusive lock on the file at path.

    Raises OSError if it is missing or cannot be opened.
    """
    fd = os.open(path, os.O_RDWR | _SAFE)
    try:
        return not lock_open(fd, shared=True)
    finally:
        os.close(fd)
