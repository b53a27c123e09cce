"""Shared-memory segments: only the supervisor creates and unlinks them, everybody else attaches without tracking.

The last page of a segment names its owner: magic, length, path of its run directory. The supervisor holds a shared lock (`flock`)
on each of its segments as long as it lives. From these two any process, in any directory or container, can decide whether a
segment is lfpipe's and whether its session lives. Nothing else is ever unlinked by name.

Python's resource tracker is not told of any segment. It unlinks by name after its process has died, when the next session may
have that name already, and up to Python 3.12 also segments that its process only attached (cpython issue 82300).
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import struct
import threading
from collections.abc import Iterator
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.host import shared_memory
from lfpipe.host.file_lock import lock
from lfpipe.host.shared_memory import SHM_DIR
from lfpipe.host.users import user_id, user_name

MAGIC = b"LFSEGM1\0"
PREFIX = "lfp-"  # of every segment's name
PAGE = 4096
_OWNER = struct.Struct("<8sq")  # magic, length of the path that follows
_attach_lock = threading.Lock()


class WrongSegment(UserError, ValueError):
    """A segment that holds something else than its reader expects, or another version of it."""


class Segment(SharedMemory):
    """A segment that this process created. `unlink` never removes another segment that has its name by now."""

    def __init__(self, name: str) -> None:
        with _untracked():
            super().__init__(name=name)
        self._identity = _identity(self._fd)  # type: ignore[attr-defined]
        lock(self._fd, shared=True)  # type: ignore[attr-defined]

    def unlink(self) -> None:
        """Removes the name. Raises FileNotFoundError if it is no longer this segment's."""
        if shared_memory.identity(self.name) != self._identity:
            raise FileNotFoundError(errno.ENOENT, "another segment has that name", self.name)
        shared_memory.unlink(self.name)


def create(name: str, size_bytes: int, run_dir: Path | None = None) -> Segment:
    """Creates a segment of size_bytes zeros for the session of run_dir. Its pages exist: a full /dev/shm is an error here.

    Raises UserError if there is no room, if the name is taken, and if shared memory cannot be created at all.
    """
    path = os.fsencode(run_dir) if run_dir else b""
    owner = (_OWNER.pack(MAGIC, len(path)) + path).ljust(PAGE, b"\0")
    whole_bytes = -(-size_bytes // PAGE) * PAGE + PAGE
    try:
        fd = shared_memory.create(name, whole_bytes, owner)
    except FileExistsError:
        raise UserError(
            f"{SHM_DIR / name}: {_kind(SHM_DIR / name)} is in the way", "remove it, or another --session name"
        ) from None
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.ENOMEM):
            remedy = f"a tmpfs at {SHM_DIR} that you may write to: docker run --shm-size=128m, or mount one there"
            raise UserError(f"{SHM_DIR}: no shared memory can be made: {error.strerror}", remedy) from None
        free, total = shared_memory.room()
        raise UserError(
            f"{SHM_DIR} has {free / 1e6:.1f} MB free of {total / 1e6:.1f} MB, {name} needs {whole_bytes / 1e6:.1f} MB",
            f"mount -o remount,size={max(64, 2 * whole_bytes >> 20)}m {SHM_DIR}, or docker run --shm-size=128m, "
            "or smaller camera.width_px and camera.height_px",
        ) from None
    try:
        return Segment(name)
    finally:
        os.close(fd)  # the lock lives on in the segment's own descriptor


def _kind(path: Path) -> str:
    """Describes what is at path."""
    try:
        found = path.lstat()
    except OSError:
        return "something"
    kinds = {stat.S_IFDIR: "a directory", stat.S_IFLNK: "a link", stat.S_IFREG: "a file"}
    kind = kinds.get(stat.S_IFMT(found.st_mode), "something")
    if found.st_uid == user_id():
        return f"{kind} that lfpipe did not make"
    return f"{kind} of user {user_name(found.st_uid)}"


def attach(name: str) -> SharedMemory:
    """Opens an existing segment, untracked. Raises FileNotFoundError."""
    with _untracked():
        return SharedMemory(name=name)


@contextlib.contextmanager
def _untracked() -> Iterator[None]:
    """Keeps segments that are opened within from the resource tracker."""
    with _attach_lock:
        register = resource_tracker.register
        resource_tracker.register = lambda name, rtype: None
        try:
            yield
        finally:
            resource_tracker.register = register


def buffer(memory: SharedMemory) -> memoryview:
    """The bytes of an open segment."""
    assert memory.buf is not None, f"{memory.name} is closed"
    return memory.buf


def check(memory: SharedMemory, magic: bytes, what: str, size_bytes: int) -> None:
    """Raises WrongSegment, and closes memory, if it does not begin with magic or is too short. what: its name in words."""
    found, size = bytes(buffer(memory)[: len(magic)]), memory.size
    if found == magic and size >= size_bytes:
        return
    memory.close()
    said = f"begins with {found!r}" if found != magic else f"has {size} bytes of {size_bytes}"
    raise WrongSegment(
        f"{memory.name}: no {what} of this version (magic {magic!r}): it {said}",
        "end that session with the version of lfpipe that started it, then start it again",
    )


def _identity(fd: int) -> tuple[int, int]:
    found = os.fstat(fd)
    return found.st_dev, found.st_ino


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
    """Name, descriptor and run directory of each segment of this user whose name begins with prefix."""
    for name in shared_memory.names(prefix):
        try:
            fd = shared_memory.open_readable(name)
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
    """Segments of this user whose names begin with prefix, of living and dead sessions: name -> run directory."""
    return {name: owner for name, _, owner in _opened(prefix)}


def abandoned(prefix: str = PREFIX) -> Iterator[tuple[str, Path]]:
    """Name and run directory of those whose supervisor is dead. The caller may unlink each by name before it takes the next:
    until then no other process unlinks it, so that the name cannot pass to another segment.
    """
    for name, fd, owner in _opened(prefix):
        if lock(fd):
            with contextlib.suppress(FileNotFoundError):
                if shared_memory.identity(name) == _identity(fd):
                    yield name, owner
