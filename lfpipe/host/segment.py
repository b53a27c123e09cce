"""Shared-memory segments: mapped files of one folder, /dev/shm on Linux. Only the supervisor
creates and unlinks them; all others attach without tracking. The last page of each names its run
directory, and its creator holds a lock on it while it lives.

Not `multiprocessing.shared_memory`: its tracker unlinks by name after its process has died, when
the next session may already use that name, and it cannot say to whom a segment belongs.
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

from lfpipe.errors import UserError
from lfpipe.host.file_lock import lock_open
from lfpipe.host.limits import REMEDIES

SHM_DIR = Path("/dev/shm" if sys.platform == "linux" else tempfile.gettempdir())
WRITABLE = (
    f"mount a tmpfs at {SHM_DIR} that you may write to; of a container: docker run --shm-size=128m"
)
# errors of a kernel, a sandbox or a file system without O_TMPFILE
WITHOUT_TMPFILE = (errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOSYS, errno.ENOENT)
PREFIX = "lfp-"  # of every segment's name
MAGIC = b"LFSEGM1\0"
PAGE = 4096  # bytes; the owner has a page of its own
_OWNER = struct.Struct("<8sq")  # magic, length of the path that follows
_SAFE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


REMEDY = "end that session with the version of lfpipe that started it, then start it again"


class WrongSegment(UserError, ValueError):
    """A segment with other contents, or another version, than its reader expects."""


class Segment:
    """An open segment. locks: for its creator, who owns it while this object is open. size, buf:
    with its last page. Raises FileNotFoundError, OSError, and ValueError for an empty file.
    """

    def __init__(self, name: str, locks: bool = False) -> None:
        self.name = name
        fd = os.open(SHM_DIR / name, os.O_RDWR | _SAFE)
        try:
            self._entry = os.fstat(fd)
            self.size = self._entry.st_size
            # has a copy of the descriptor, and with it the lock
            self._map = mmap.mmap(fd, self.size)
            if locks:
                lock_open(fd, shared=True)
        finally:
            os.close(fd)
        self.buf = memoryview(self._map)

    def check(self, magic: bytes, what: str, size_bytes: int) -> None:
        """Raises WrongSegment, and closes it, if it does not begin with magic or is too short.

        what: its name for the message.
        """
        begin = bytes(self.buf[: len(magic)])
        if begin == magic and self.size >= size_bytes:
            return
        self.close()
        contents = (
            f"begins with {begin!r}" if begin != magic else f"has {self.size} bytes of {size_bytes}"
        )
        raise WrongSegment(
            f"{self.name}: not a {what} of this version (magic {magic!r}): it {contents}", REMEDY
        )

    def close(self) -> None:
        """Unmaps it. May be called again. Raises BufferError while views of it exist."""
        self.buf.release()
        self._map.close()

    def in_place(self) -> bool:
        """Whether others still reach it by its name."""
        try:
            return os.path.samestat((SHM_DIR / self.name).lstat(), self._entry)
        except FileNotFoundError:
            return False

    def unlink(self) -> None:
        """Removes the name. Raises FileNotFoundError if it is no longer this segment's."""
        if not self.in_place():
            raise FileNotFoundError(errno.ENOENT, "another segment has that name", self.name)
        unlink(self.name)


attach = Segment  # without a lock, and without the tracker of `multiprocessing`


def create(name: str, size_bytes: int, run_dir: Path | None = None) -> Segment:
    """Creates a segment, mode 0600, of size_bytes zeros for the session of run_dir.

    Raises UserError if there is too little memory, or if shared memory cannot be created at all,
    FileExistsError if the name is taken.
    """
    whole_bytes = -(-size_bytes // PAGE) * PAGE
    try:
        return _create(name, whole_bytes, os.fsencode(run_dir) if run_dir else b"")
    except FileExistsError:
        raise
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.ENOMEM):
            raise UserError(
                f"{SHM_DIR}: cannot create shared memory: {error.strerror}",
                REMEDIES.get(error.errno or 0, WRITABLE),
            ) from None
        total, _, free = (size / 1e6 for size in shutil.disk_usage(SHM_DIR))
        message = (
            f"{SHM_DIR} has {free:.1f} MB free of {total:.1f} MB; {name} needs"
            f" {whole_bytes / 1e6:.1f} MB"
        )
        remedy = f"{more_room(whole_bytes)}, or set smaller camera.width_px and camera.height_px"
        raise UserError(message, remedy) from None


def _create(name: str, whole_bytes: int, run_dir: bytes) -> Segment:
    """It gets its name only when it is complete and locked: on Linux, a process killed here leaves
    nothing. Its pages are allocated, so a full tmpfs is an error here and never a SIGBUS at a later
    write.
    """
    owner = (_OWNER.pack(MAGIC, len(run_dir)) + run_dir).ljust(PAGE, b"\0")
    try:
        fd = os.open(SHM_DIR, os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o600)
    except (AttributeError, OSError) as error:
        if isinstance(error, OSError) and error.errno not in WITHOUT_TMPFILE:
            raise
        # the session holds its lock: nobody else creates this name
        fd = os.open(SHM_DIR / name, os.O_RDWR | os.O_CREAT | os.O_EXCL | _SAFE, 0o600)
        with os.fdopen(fd, "r+b") as file:
            file.truncate(whole_bytes + PAGE)
            os.pwrite(fd, owner, whole_bytes)
            return Segment(name, locks=True)
    try:
        os.posix_fallocate(fd, 0, whole_bytes + PAGE)
        os.pwrite(fd, owner, whole_bytes)
        lock_open(fd, shared=True)
        # With a descriptor Python calls linkat, which follows the link in /proc; link would not.
        os.link(f"/proc/self/fd/{fd}", SHM_DIR / name, src_dir_fd=fd, follow_symlinks=True)
        return Segment(name, locks=True)
    finally:
        os.close(fd)  # the lock lives on in the segment's own descriptor


def more_room(needed_bytes: int) -> str:
    """The remedy for too little shared memory: more than there is now."""
    total_bytes = 0
    with contextlib.suppress(OSError):
        total_bytes = shutil.disk_usage(SHM_DIR).total
    size = max(64, (2 * needed_bytes + total_bytes) >> 20)
    return f"mount -o remount,size={size}m {SHM_DIR}, or docker run --shm-size={size}m"


def unlink(name: str) -> None:
    """Removes the name; processes that map the memory keep it. Raises FileNotFoundError."""
    (SHM_DIR / name).unlink()


def _owner(fd: int) -> Path | None:
    """Run directory of an open segment, empty if it was created without one; None if it is not
    lfpipe's or not this user's.
    """
    entry = os.fstat(fd)
    if not stat.S_ISREG(entry.st_mode) or entry.st_uid != os.getuid() or entry.st_size < PAGE:
        return None
    page = os.pread(fd, PAGE, entry.st_size - PAGE)
    magic, length = _OWNER.unpack_from(page)
    path = page[_OWNER.size : _OWNER.size + max(0, length)]
    return (
        Path(os.fsdecode(path))
        if magic == MAGIC and len(path) == length and b"\0" not in path
        else None
    )


def _opened(prefix: str) -> Iterator[tuple[str, int, Path]]:
    """Yields name, descriptor and run directory of each segment of this user whose name begins with
    prefix.
    """
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


def owned(prefix: str = PREFIX) -> dict[str, Path]:
    """Segments of this user whose names begin with prefix, of living and dead sessions: name -> run
    directory.
    """
    return {name: owner for name, _, owner in _opened(prefix)}


def abandoned(prefix: str = PREFIX) -> Iterator[tuple[str, Path]]:
    """Yields name and run directory of segments whose creator is dead. The caller may unlink each
    by name before it takes the next: until then no other process unlinks it, so the name cannot
    pass to another segment.
    """
    for name, fd, owner in _opened(prefix):
        with contextlib.suppress(FileNotFoundError):
            if lock_open(fd) and os.path.samestat((SHM_DIR / name).lstat(), os.fstat(fd)):
                yield name, owner
