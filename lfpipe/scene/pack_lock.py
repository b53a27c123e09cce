"""A shared lock on a pack's folder, so that `lfpipe scene clean` keeps packs in use."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from lfpipe.host import file_lock


class PackLock:
    """Protects a pack from removal while this object lives. A killed process holds no lock."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError if there is no such folder or it is being removed."""
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
        """Pickles as None: a lock is not copied to another process."""
        return type(None), ()


@contextlib.contextmanager
def unused(folder: Path) -> Iterator[bool]:
    """Whether no process holds the pack; if so, none can lock it until the end of the block. Raises OSError."""
    if not folder.is_dir():
        raise FileNotFoundError(2, os.strerror(2), str(folder))
    lock = file_lock.take(folder)
    try:
        yield lock is not None
    finally:
        if lock is not None:
            lock.release()
