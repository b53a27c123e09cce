"""Named shared memory: mapped files of one folder, /dev/shm on Linux. The last page of each names its run directory, and its
creator holds a lock on it while it lives.

Not `multiprocessing.shared_memory`: its tracker unlinks by name after its process has died, when the next session may already
use that name, and it cannot say to whom a segment belongs.
"""

import contextlib
import errno
import mmap
import os
import shutil
import stat
import struct
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from lfpipe.host.file_lock import lock_open

SHM_DIR = Path("/dev/shm" if sys.platform == "linux" else tempfile.gettempdir())
WRITABLE = f"a tmpfs at {SHM_DIR} that you may write to: docker run --shm-size=128m, or mount one there"
MAGIC = b"LFSEGM1\0"
PAGE = 4096
_OWNER = struct.Struct("<8sq")  # magic, length of the path that follows
_SAFE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class Mapping:
    """An open segment. name, size: with its last page. buf: its bytes, None once closed. Raises FileNotFoundError, OSError, and
    ValueError for an empty file."""

    def __init__(self, name: str, locks: bool = False) -> None:
        self.name = name
        fd = os.open(SHM_DIR / name, os.O_RDWR | _SAFE)
        try:
            entry = os.fstat(fd)
            self.size, self._identity = entry.st_size, (entry.st_dev, entry.st_ino)
            self._map = mmap.mmap(fd, self.size)  # has a copy of the descriptor, and with it the lock
            if locks:
                lock_open(fd, shared=True)
        finally:
            os.close(fd)
        self.buf: memoryview | None = memoryview(self._map)

    def close(self) -> None:
        """Unmaps it. May be called again. Raises BufferError while views of it exist."""
        if self.buf is not None:
            self.buf.release()
            self.buf = None
        self._map.close()


class Segment(Mapping):
    """A segment that this process created. `unlink` never removes another segment that has taken its name."""

    def __init__(self, name: str) -> None:
        super().__init__(name, locks=True)

    def unlink(self) -> None:
        """Removes the name. Raises FileNotFoundError if it is no longer this segment's."""
        if identity(self.name) != self._identity:
            raise FileNotFoundError(errno.ENOENT, "another segment has that name", self.name)
        unlink(self.name)


def create(name: str, size_bytes: int, run_dir: bytes) -> Segment:
    """Creates a segment, mode 0600, of at least size_bytes zeros for the session of run_dir.

    It gets its name only when it is complete and locked: on Linux, a process killed here leaves nothing. Its pages are allocated,
    so a full tmpfs is an error here and never a SIGBUS at a later write. Raises OSError, FileExistsError if the name is taken.
    """
    owner = (_OWNER.pack(MAGIC, len(run_dir)) + run_dir).ljust(PAGE, b"\0")
    whole = size_bytes + PAGE
    if not hasattr(os, "O_TMPFILE"):  # the session holds its lock: nobody else creates this name
        fd = os.open(SHM_DIR / name, os.O_RDWR | os.O_CREAT | os.O_EXCL | _SAFE, 0o600)
        with os.fdopen(fd, "r+b") as file:
            file.truncate(whole)
            os.pwrite(fd, owner, size_bytes)
            return Segment(name)
    directory = os.open(SHM_DIR, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fd = os.open(".", os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o600, dir_fd=directory)
        try:
            os.posix_fallocate(fd, 0, whole)
            os.pwrite(fd, owner, size_bytes)
            lock_open(fd, shared=True)
            # With src_dir_fd Python calls linkat, which follows the link in /proc; link would not.
            os.link(f"/proc/self/fd/{fd}", name, src_dir_fd=directory, dst_dir_fd=directory, follow_symlinks=True)
            return Segment(name)
        finally:
            os.close(fd)  # the lock lives on in the segment's own descriptor
    finally:
        os.close(directory)


def identity(name: str) -> tuple[int, int]:
    """Identifies the segment that currently has this name. Raises FileNotFoundError."""
    entry = (SHM_DIR / name).lstat()
    return entry.st_dev, entry.st_ino


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
    entry = os.fstat(fd)
    if not stat.S_ISREG(entry.st_mode) or entry.st_uid != os.getuid() or entry.st_size < PAGE:
        return None
    page = os.pread(fd, PAGE, entry.st_size - PAGE)
    magic, length = _OWNER.unpack_from(page)
    path = page[_OWNER.size : _OWNER.size + max(0, length)]
    return Path(os.fsdecode(path)) if magic == MAGIC and len(path) == length and b"\0" not in path else None


def _opened(prefix: str) -> Iterator[tuple[str, int, Path]]:
    """Yields name, descriptor and run directory of each segment of this user whose name begins with prefix."""
    try:
        names = sorted(path.name for path in SHM_DIR.iterdir() if path.name.startswith(prefix))
    except OSError:
        return
    for name in names:
        try:
            fd = os.open(SHM_DIR / name, os.O_RDONLY | _SAFE)
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
                if os.path.samestat((SHM_DIR / name).lstat(), os.fstat(fd)):
                    yield name, owner
