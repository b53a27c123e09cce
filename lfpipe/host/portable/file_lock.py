"""Locks on files and folders without the kernel's help: every holder has its own entry, named after its process.

A lock is granted if no living process has a conflicting entry. Any process may remove the entry of a dead one, safely, because no
name is used twice. Two processes that try at the same moment may both fail.
"""

import contextlib
import os
import random
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from lfpipe.host.paths import is_dir
from lfpipe.host.portable.liveness import lives, own_mark

PREFIX, SHARED, ALONE = ".held-", "s", "x"
PAUSE_S = 0.01


def _entries(path: Path) -> Path:
    """The folder of a lock's entries: the locked folder itself, or one beside the locked file."""
    return path if is_dir(path) else path.with_name(f"{path.name}.d")


def _others(folder: Path, own: str = "") -> Iterator[str]:
    """Kinds of the entries of living processes; removes the others."""
    for entry in folder.glob(f"{PREFIX}*"):
        kind, _, rest = entry.name.removeprefix(PREFIX).partition("-")
        mark, _, _ = rest.rpartition("-")
        if entry.name == own:
            continue
        if lives(mark):
            yield kind
        else:
            with contextlib.suppress(OSError):
                entry.unlink()


class Lock:
    """A lock that this process holds on the file or folder at path, by its entry."""

    def __init__(self, path: Path, entry: Path) -> None:
        self._path, self._entry = path, entry

    def in_place(self) -> bool:
        """Whether the lock still exists. True if the path cannot be examined."""
        try:
            self._entry.lstat()
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            return True
        return True

    def release(self) -> None:
        """Releases the lock; may be called again."""
        with contextlib.suppress(OSError):
            self._entry.unlink()
        if self._entry.parent != self._path:
            with contextlib.suppress(OSError):  # another process is trying right now
                self._entry.parent.rmdir()

    def remove_folder(self) -> None:
        """Removes the folder of the locked file with its content, the lock last. Leaves what cannot be removed."""
        for entry in list(self._path.parent.iterdir()) if self.in_place() else ():
            if entry == self._entry.parent:
                continue
            if is_dir(entry) and not entry.is_symlink():
                shutil.rmtree(entry, ignore_errors=True)
            else:
                with contextlib.suppress(OSError):
                    entry.unlink()
        self.release()
        with contextlib.suppress(OSError):
            self._path.parent.rmdir()


def take(path: Path, shared: bool = False, mode: int = 0o600) -> Lock | None:
    """Locks path without waiting: a folder, or the name of a file. None if another process holds a conflicting lock.

    Raises OSError, FileNotFoundError if the folder of a file is missing.
    """
    folder = _entries(path)
    entry = folder / f"{PREFIX}{SHARED if shared else ALONE}-{own_mark()}-{secrets.token_hex(8)}"
    for _ in range(100):
        if folder != path:
            with contextlib.suppress(FileExistsError):  # not exist_ok: the folder may vanish before that checks
                folder.mkdir(mode=0o700)
        try:
            os.close(os.open(entry, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
            break
        except FileNotFoundError:  # its last holder has just removed the folder of entries
            if folder == path:
                raise
    made = Lock(path, entry)
    if any(not shared or kind != SHARED for kind in _others(folder, entry.name)):
        made.release()
        return None
    return made


@contextlib.contextmanager
def waited_for(path: Path) -> Iterator[None]:
    """Holds the lock of a file's name; waits until no other process holds one. Raises OSError."""
    while (lock := take(path)) is None:
        time.sleep(PAUSE_S * random.random())
    try:
        yield
    finally:
        lock.release()


def is_held(path: Path) -> bool:
    """Whether a process holds an exclusive lock on the file's name. Raises OSError if its folder is missing."""
    path.parent.stat()
    return ALONE in _others(_entries(path))
