"""The lock file of a run directory: its holder owns the session. The lock ends with its process."""

import contextlib
import errno
import os
import stat
import time
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.host import file_lock
from lfpipe.host.file_lock import Lock
from lfpipe.host.files import is_dir, user_id

ATTEMPTS = 30  # to take a lock, PAUSE_S apart
PAUSE_S = 0.01


def is_own_directory(path: Path) -> bool:
    """Whether path is a directory of this user and not a link: in /tmp, anybody may create one with our name. Raises OSError."""
    found = path.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid == user_id()


def _make_directory(path: Path) -> None:
    """Creates path with mode 0700, or sets that mode if it exists. Raises UserError if it is not this user's directory."""
    while True:
        try:
            path.mkdir(mode=0o700)
            return
        except FileExistsError:
            with contextlib.suppress(FileNotFoundError):  # another process has just removed it: create it
                if not is_own_directory(path):
                    raise UserError(f"{path} is not a directory of yours", "remove it, or use another --session name") from None
                path.chmod(0o700)
                return
        except OSError as error:
            raise UserError(f"{path}: {error.strerror}", "set XDG_RUNTIME_DIR to a directory that you may write to") from None


def take(path: Path, make: bool = False) -> Lock | None:
    """Locks the file at path, created if missing; None if another process holds it.

    make: also creates its directory. Otherwise None if that is missing. Raises OSError, and UserError for a directory of another
    user. A sweep treats an unlocked directory as a dead session's, so a lock is valid only if the file still exists.
    """
    while True:
        if make:
            _make_directory(path.parent)
        try:
            if is_dir(path):
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
            lock = file_lock.take(path)
        except FileNotFoundError:
            if make:
                continue
            return None
        if lock is None or lock.in_place():
            return lock
        lock.release()


def take_patiently(path: Path) -> Lock | None:
    """As `take` with make, but retries for 0.3 s: a process that sweeps or lists sessions holds a lock briefly."""
    for _ in range(ATTEMPTS):
        if (lock := take(path, make=True)) is not None:
            return lock
        time.sleep(PAUSE_S)
    return None
