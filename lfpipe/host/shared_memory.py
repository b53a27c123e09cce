"""Named shared memory: on Linux, files of a tmpfs. `multiprocessing.shared_memory` maps the segments created here.

The last page of a segment names its owner: magic, length, path of its run directory. Its creator holds a shared lock (`flock`) on
it for life. From these two facts any process, in any directory or container, can decide whether a segment is lfpipe's and whether
its session lives. Nothing else is ever unlinked by name.
"""

import contextlib
import errno
import os
import shutil
import stat
import struct
from collections.abc import Iterator
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

from lfpipe.host.file_lock import lock_open
from lfpipe.host.segment_names import names_in
from lfpipe.host.untracked import untracked
from lfpipe.host.users import user_id

SHM_DIR = Path("/dev/shm")
WHERE = str(SHM_DIR)  # for messages
WRITABLE = f"a tmpfs at {SHM_DIR} that you may write to: docker run --shm-size=128m, or mount one there"
MAGIC = b"LFSEGM1\0"
PAGE = 4096
_OWNER = struct.Struct("<8sq")  # magic, length of the path that follows


class Segment(SharedMemory):
    """A segment that this process created. `unlink` never removes another segment that has taken its name."""

    def __init__(self, name: str) -> None:
        with untracked():
            super().__init__(name=name)
        self._identity = _identity(self._fd)  # type: ignore[attr-defined]
        lock_open(self._fd, shared=True)  # type: ignore[attr-defined]

    def unlink(self) -> None:
        """Removes the name. Raises FileNotFoundError if it is no longer this segment's."""
        if identity(self.name) != self._identity:
            raise FileNotFoundError(errno.ENOENT, "another segment has that name", self.name)
        unlink(self.name)


def create(name: str, size_bytes: int, run_dir: bytes) -> Segment:
    """Creates a segment, mode 0600, of at least size_bytes zeros for the session of run_dir.

    It gets its name only when it is complete and locked: a process killed here leaves nothing. Its pages are allocated, so a full
    tmpfs is an error here and never a SIGBUS at a later write. Raises OSError, FileExistsError if the name is taken.
    """
    owner = (_OWNER.pack(MAGIC, len(run_dir)) + run_dir).ljust(PAGE, b"\0")
    directory = os.open(SHM_DIR, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fd = os.open(".", os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o600, dir_fd=directory)
        try:
            os.posix_fallocate(fd, 0, size_bytes + PAGE)
            os.pwrite(fd, owner, size_bytes)
            lock_open(fd, shared=True)
            # With src_dir_fd Python calls linkat, which follows the link in /proc; link would not.
            os.link(f"/proc/self/fd/{fd}", name, src_dir_fd=directory, dst_dir_fd=directory, follow_symlinks=True)
            return Segment(name)
        finally:
            os.close(fd)  # the lock lives on in the segment's own descriptor
    finally:
        os.close(directory)


def _identity(fd: int) -> tuple[int, int]:
    found = os.fstat(fd)
    return found.st_dev, found.st_ino


def identity(name: str) -> tuple[int, int]:
    """Identifies the segment that currently has this name. Raises FileNotFoundError."""
    found = (SHM_DIR / name).lstat()
    return found.st_dev, found.st_ino


def unlink(name: str) -> None:
    """Removes the name; processes that map the memory keep it. Raises FileNotFoundError."""
    (SHM_DIR / name).unlink()


def room() -> tuple[int, int]:
    """Free and total bytes for segments. Raises OSError."""
    usage = shutil.disk_usage(SHM_DIR)
    return usage.free, usage.total


def more_room(needed_bytes: int) -> str:
    """The remedy for too little room."""
    return f"mount -o remount,size={max(64, 2 * needed_bytes >> 20)}m {SHM_DIR}, or docker run --shm-size=128m"


def _owner(fd: int) -> Path | None:
    """Run directory of an open segment, empty if it was created without one; None if it is not lfpipe's or not this user's."""
    found = os.fstat(fd)
    if not stat.S_ISREG(found.st_mode) or found.st_uid != user_id() or found.st_size < PAGE:
        return None
    page = os.pread(fd, PAGE, found.st_size - PAGE)
    magic, length = _OWNER.unpack_from(page)
    path = page[_OWNER.size : _OWNER.size + max(0, length)]
    return Path(os.fsdecode(path)) if magic == MAGIC and len(path) == length and b"\0" not in path else None


def _opened(prefix: str) -> Iterator[tuple[str, int, Path]]:
    """Yields name, descriptor and run directory of each segment of this user whose name begins with prefix."""
    for name in names_in(SHM_DIR, prefix):
        try:
            fd = os.open(SHM_DIR / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError:
            continue  # just removed, another user's, a link, ...
        try:
            owner = _owner(fd)
            if owner is not None:
                yield name, fd, owner
        except OSError:
            continue
        finally:
            os.close(fd)


def owned(prefix: str) -> dict[str, Path]:
    """Segments of this user whose names begin with prefix, of living and dead sessions: name -> run directory."""
    return {name: owner for name, _, owner in _opened(prefix)}


def abandoned(prefix: str) -> Iterator[tuple[str, Path]]:
    """Yields name and run directory of segments whose creator is dead. The caller may unlink each by name before it takes the
    next: until then no other process unlinks it, so the name cannot pass to another segment.
    """
    for name, fd, owner in _opened(prefix):
        if lock_open(fd):
            with contextlib.suppress(FileNotFoundError):
                if identity(name) == _identity(fd):
                    yield name, owner
