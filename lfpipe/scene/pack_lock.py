"""Who uses a pack: a shared lock on its folder, so that `lfpipe scene clean` leaves alone what a session shows."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from lfpipe.host import file_lock


class PackLock:
    """Keeps a pack from being removed while this object lives, in whatever process. A killed process holds nothing."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError where there is no such folder or it is being removed."""
        self._lock = None
        if not folder.is_dir():
            raise FileNotFoundError(2, os.strerror(2), str(folder))
        self._lock = file_lock.take(folder, shared=True)
        if self._lock is None:
            raise BlockingIOError(11, "it is being removed", str(folder))
        if not self._lock.in_place():
            raise FileNotFoundError(2, "it was removed", str(folder))

    def __del__(self) -> None:
        if self._lock is not None:
            self._lock.release()

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        """A lock is not copied to another process: there it is None."""
        return type(None), ()


@contextlib.contextmanager
def unused(folder: Path) -> Iterator[bool]:
    """Whether nobody holds the pack; if so, nobody can until the end of the block. Raises OSError."""
    if not folder.is_dir():
        raise FileNotFoundError(2, os.strerror(2), str(folder))
    lock = file_lock.take(folder)
    try:
        yield lock is not None
    finally:
        if lock is not None:
            lock.release()
