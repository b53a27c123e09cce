"""Files: what a path is, open files by name, locks, shared memory, wake-ups, and the limits of the
operating system.

`exists`, `is_file`, `is_dir` are False where a path cannot be examined. `Path.exists` and its like
raise OSError up to Python 3.13, for a folder that may not be searched, a name that is too long, a
network drive that has gone. To learn the reason, open the path.

The kernel drops locks when their process ends (`flock`). Shared memory is mapped files of the
directory of a session, in /dev/shm on Linux; who owns the directory makes and removes them. Not
`multiprocessing.shared_memory`: its tracker unlinks by name after its process has died, when the
next session may already use that name.

A wake-up notifies the one reader of a ring that the slot of an 8-byte seq is published. Its
descriptor goes into the same zmq.Poller as sockets and sentinels. A wake-up may be lost while
others are pending: the reader takes the newest slot, so it misses nothing.

Open files are raised to the limit before a session starts, because some libraries abort if it is
too low. Memory is limited only if the system reports the use of a process.
"""

import contextlib
import errno
import fcntl
import mmap
import os
import resource
import select
import shutil
import struct
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from os.path import exists, isdir, isfile
from pathlib import Path
from typing import IO, Self

from lfpipe.errors import UserError

OPEN_FILES = 128  # about 30 for a stage, as many for the supervisor, and a reserve
# more is useless, and some programs close every number up to the limit;
# macOS refuses more than OPEN_MAX
MAX_FILES = 1 << 16 if sys.platform == "linux" else 1 << 13


# errno of a call -> what helps against the limit that it hit
REMEDIES = {
    errno.EFBIG: "raise the limit of a file's size: `ulimit -f unlimited`, or LimitFSIZE= in a"
    " systemd unit",
    errno.EMFILE: "raise the limit of open files: `ulimit -n 1024`, or LimitNOFILE= in a systemd"
    " unit",
    errno.ENFILE: "end other programs: the whole system may open no more files",
}


def allow_files() -> None:
    """Raises the limit of open files, for this process and its children, to the hard limit.

    Raises UserError if that is fewer than OPEN_FILES.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= hard < OPEN_FILES:
        raise UserError(
            f"{hard} open files are allowed here (RLIMIT_NOFILE); a session needs {OPEN_FILES}",
            "run `ulimit -n 1024` in the shell that starts it, or set LimitNOFILE= in its systemd"
            " unit",
        )
    most = MAX_FILES if hard < 0 else min(hard, MAX_FILES)
    if 0 <= soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def free_files() -> int:
    """How many more files this process may open."""
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0] - len([*Path("/dev/fd").iterdir()])


class MemoryLimit:
    """A context in which this process may use only this much more memory than at its creation:
    larger allocations fail. Shared memory and mapped files do not count.
    """

    def __init__(self, more_bytes: int) -> None:
        self._most: int | None = None
        with contextlib.suppress(OSError, StopIteration):
            lines = Path("/proc/self/status").read_text().splitlines()
            self._most = more_bytes + 1024 * next(
                int(line.split()[1]) for line in lines if line.startswith("VmData")
            )

    def __enter__(self) -> Self:
        if self._most is not None:
            self._before = resource.getrlimit(resource.RLIMIT_DATA)
            hard = self._before[1]  # of the user or of a container: it stays
            resource.setrlimit(
                resource.RLIMIT_DATA, (self._most if hard < 0 else min(self._most, hard), hard)
            )
        return self

    def __exit__(self, *_: object) -> None:
        if self._most is not None:
            resource.setrlimit(resource.RLIMIT_DATA, self._before)


__all__ = ["exists", "is_dir", "is_file"]
is_dir = isdir
is_file = isfile


# for files that a user names: opening waits for no other process and acquires no terminal
CAREFUL = os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
CREATING = CAREFUL | os.O_NOFOLLOW  # a link in the place of a new file is refused
_DESCRIPTORS = "/proc/self/fd" if sys.platform == "linux" else "/dev/fd"


def is_missing(path: str | os.PathLike[str]) -> bool:
    """Whether there is certainly nothing at path, not even a broken link."""
    try:
        os.lstat(path)
    except OSError as error:
        return isinstance(error, FileNotFoundError | NotADirectoryError)
    return False


def proc_fd_path(file: IO[bytes]) -> str:
    """A plain ASCII path to an open file, whatever its own name is, and even if it has none."""
    return f"{_DESCRIPTORS}/{file.fileno()}"


def reserve(path: Path) -> None:
    """Reserves disk space for all of a file, so that a map of it can be written.

    Raises OSError if it is full.
    """
    with path.open("r+b") as file:
        if hasattr(os, "posix_fallocate"):  # macOS has none: a full disk is a signal there
            os.posix_fallocate(file.fileno(), 0, os.fstat(file.fileno()).st_size)


_SAFE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
PAUSE_S, _REPORT_S = 0.01, 1.0  # between attempts; between reports to a person


def lock_open(fd: int, shared: bool = False) -> bool:
    """Locks an open file without waiting; False if another process holds a conflicting lock.

    Raises OSError.
    """
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class Lock:
    """A lock that this process holds on the file at path.

    fd: open and locked; closed by this object.
    """

    def __init__(self, path: Path, fd: int) -> None:
        self._path = path
        self._fd = fd

    def in_place(self) -> bool:
        """Whether the locked file is still at its path. True if the path cannot be examined."""
        try:
            return os.path.samestat(self._path.lstat(), os.fstat(self._fd))
        except OSError as error:
            return not isinstance(error, FileNotFoundError | NotADirectoryError)

    def release(self) -> None:
        """Releases the lock."""
        os.close(self._fd)


def lock_file(path: Path) -> Lock | None:
    """Locks the file at path, created if missing, without waiting; None if another process holds a
    lock. Raises OSError.
    """
    fd = os.open(path, os.O_RDWR | os.O_CREAT | _SAFE, 0o600)
    if lock_open(fd):
        return Lock(path, fd)
    os.close(fd)
    return None


@contextlib.contextmanager
def waited_for(path: Path, waiting: Callable[[], None]) -> Iterator[None]:
    """Holds the lock of a file, created if missing; waits until no other process holds one.
    waiting: called once a second meanwhile. Raises OSError.
    """
    report_s = time.monotonic() + _REPORT_S
    while (lock := lock_file(path)) is None:
        time.sleep(PAUSE_S)
        if time.monotonic() >= report_s:
            report_s += _REPORT_S
            waiting()
    try:
        yield
    finally:
        lock.release()


def is_held(path: Path) -> bool:
    """Whether a process holds an exclusive lock on the file at path.

    Raises OSError if it is missing or cannot be opened.
    """
    fd = os.open(path, os.O_RDWR | _SAFE)
    try:
        return not lock_open(fd, shared=True)
    finally:
        os.close(fd)


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

    def remove(self) -> None:
        """Removes the name, if it is still this segment's, and unmaps it; another process that maps
        the memory keeps it.
        """
        if self.in_place():
            self.path.unlink()
        self.close()


def create_segment(path: Path, size_bytes: int) -> Segment:
    """Creates a segment, mode 0600, of zeros. `publish_segment` gives it its name.

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


def publish_segment(memory: Segment, path: Path) -> None:
    """Names a segment that is complete."""
    memory.path.rename(path)
    memory.path = path


_SEQ = struct.Struct("@Q")


def make_fifo(path: Path) -> None:
    """Creates what both ends open, for its owner only. Only the supervisor calls this."""
    os.mkfifo(path, 0o600)


def readable(fds: Sequence[int], seconds: float) -> list[int]:
    """Sleeps until one of the descriptors can be read, or for seconds, to the microsecond; returns
    those that can.
    """
    return select.select(fds, (), (), seconds)[0]


class Wake:
    """Either end of a named FIFO. Both open it O_RDWR | O_NONBLOCK: no order of opening, no
    SIGPIPE, and it survives a restart of either side.
    """

    def __init__(self, path: Path) -> None:
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK)

    def notify(self, seq: int) -> None:
        """Wakes the reader for seq."""
        with contextlib.suppress(BlockingIOError):  # full: the reader is awake
            os.write(self.fd, _SEQ.pack(seq))

    def drain(self) -> int:
        """Reads all wakes, at most MOST; returns the last seq, 0 if there was none."""
        try:
            # 4 KiB at once, the rest next time
            data = os.read(self.fd, 512 * _SEQ.size)
        except BlockingIOError:
            return 0
        whole = len(data) // _SEQ.size * _SEQ.size
        return int(_SEQ.unpack_from(data, whole - _SEQ.size)[0]) if whole else 0

    def close(self) -> None:
        os.close(self.fd)
