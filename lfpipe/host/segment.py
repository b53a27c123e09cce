"""Shared memory: mapped files of the directory of a session, in /dev/shm on Linux. Who owns the
directory makes and removes them.

Not `multiprocessing.shared_memory`: its tracker unlinks by name after its process has died, when
the next session may already use that name.
"""

import errno
import mmap
import os
import shutil
import sys
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.host.limits import REMEDIES

SHM_DIR = Path("/dev/shm")  # a file system in memory, which other systems than Linux lack
PAGE = 4096  # bytes
REMEDY = "end that session with the version of lfpipe that started it, then start it again"


class WrongSegment(UserError, ValueError):
    """A segment with other contents, or another version, than its reader expects."""


class Segment:
    """An open segment. Raises FileNotFoundError, OSError, and ValueError for an empty file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        fd = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            self._entry = os.fstat(fd)
            self.size = self._entry.st_size
            self._map = mmap.mmap(fd, self.size)
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
            f"{self.path}: not a {what} of this version (magic {magic!r}): it {contents}", REMEDY
        )

    def close(self) -> None:
        """Unmaps it. May be called again. Raises BufferError while views of it exist."""
        self.buf.release()
        self._map.close()

    def in_place(self) -> bool:
        """Whether others still reach it by its name."""
        try:
            return os.path.samestat(self.path.lstat(), self._entry)
        except FileNotFoundError:
            return False

    def unlink(self) -> None:
        """Removes the name, if it is still this segment's; who maps the memory keeps it."""
        if self.in_place():
            self.path.unlink()


def create(path: Path, size_bytes: int) -> Segment:
    """Creates a segment, mode 0600, of zeros. `publish` gives it its name.

    Raises UserError if there is too little memory, or if a file cannot be created at all.
    """
    hidden = path.with_name(f".{path.name}")
    size_bytes = -(-size_bytes // PAGE) * PAGE
    try:
        fd = os.open(hidden, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
        try:
            # so that a full memory is an error here, and never a SIGBUS at a later write
            if sys.platform == "linux":
                os.posix_fallocate(fd, 0, size_bytes)
            else:
                os.truncate(fd, size_bytes)
        finally:
            os.close(fd)
        return Segment(hidden)
    except OSError as error:
        hidden.unlink(missing_ok=True)
        if error.errno not in (errno.ENOSPC, errno.ENOMEM):
            raise UserError(
                f"{path.parent}: cannot create shared memory: {error.strerror}",
                REMEDIES.get(error.errno or 0, "set LFPIPE_RUN_DIR to another directory"),
            ) from None
        total, _, free = (size / 1e6 for size in shutil.disk_usage(path.parent))
        message = (
            f"{path.parent} has {free:.1f} MB free of {total:.1f} MB; {path.name} needs"
            f" {size_bytes / 1e6:.1f} MB"
        )
        size = max(64, int(total + 2 * size_bytes / 1e6))
        remedy = (
            f"mount -o remount,size={size}m {SHM_DIR}, or docker run --shm-size={size}m, or set"
            " smaller camera.width_px and camera.height_px"
        )
        raise UserError(message, remedy) from None


def publish(memory: Segment, path: Path) -> None:
    """Names a segment that is complete."""
    memory.path.rename(path)
    memory.path = path
