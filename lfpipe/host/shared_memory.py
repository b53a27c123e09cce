"""Named shared memory: on Linux the files of a tmpfs. `multiprocessing.shared_memory` maps what is created here."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from lfpipe.host.file_lock import lock

SHM_DIR = Path("/dev/shm")


def create(name: str, size_bytes: int, end: bytes) -> int:
    """Creates a segment, mode 0600, of zeros with end as its last bytes; returns a descriptor that holds a shared lock on it.

    It gets its name only when it is complete and locked: a process killed in here leaves nothing. Its pages exist, so that a full
    tmpfs is an error here and never a SIGBUS at a later write. Raises OSError, FileExistsError if the name is taken.
    """
    directory = os.open(SHM_DIR, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fd = os.open(".", os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o600, dir_fd=directory)
        try:
            os.posix_fallocate(fd, 0, size_bytes)
            os.pwrite(fd, end, size_bytes - len(end))
            lock(fd, shared=True)
            # With src_dir_fd Python calls linkat, which follows the link in /proc; link would not.
            os.link(f"/proc/self/fd/{fd}", name, src_dir_fd=directory, dst_dir_fd=directory, follow_symlinks=True)
        except BaseException:
            os.close(fd)
            raise
    finally:
        os.close(directory)
    return fd


def open_readable(name: str) -> int:
    """Opens what has that name, read-only, without following links or waiting for pipes. Raises OSError."""
    return os.open(SHM_DIR / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)


def names(prefix: str) -> list[str]:
    """Names that begin with prefix, of files of any kind; empty if they cannot be listed."""
    try:
        return sorted(path.name for path in SHM_DIR.iterdir() if path.name.startswith(prefix))
    except OSError:
        return []


def identity(name: str) -> tuple[int, int]:
    """Device and inode of what has that name now, as `fstat` of a descriptor gives them. Raises FileNotFoundError."""
    found = (SHM_DIR / name).lstat()
    return found.st_dev, found.st_ino


def unlink(name: str) -> None:
    """Removes the name; processes that map the memory keep it. Raises FileNotFoundError."""
    (SHM_DIR / name).unlink()


def room() -> tuple[int, int]:
    """Free and total bytes for segments. Raises OSError."""
    usage = shutil.disk_usage(SHM_DIR)
    return usage.free, usage.total
