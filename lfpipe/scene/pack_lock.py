"""Who uses a pack: a shared lock on its folder, so that `lfpipe scene clean` leaves alone what a session shows."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from lfpipe.host.file_lock import lock


class PackLock:
    """Keeps a pack from being removed while this object lives, in whatever process. A killed process holds nothing."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError where there is no such folder or it is being removed."""
        self._fd = -1
        self._fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        if not lock(self._fd, shared=True):
            raise BlockingIOError(11, "it is being removed", str(folder))
        if not os.path.samestat(os.fstat(self._fd), folder.stat()):
            raise FileNotFoundError(2, "it was removed", str(folder))

    def __del__(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        """A lock is not copied to another process: there it is None."""
        return type(None), ()


@contextlib.contextmanager
def unused(folder: Path) -> Iterator[bool]:
    """Whether nobody holds the pack; if so, nobody can until the end of the block. Raises OSError."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield lock(fd)
    finally:
        os.close(fd)
