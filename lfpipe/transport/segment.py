"""Shared-memory segments: made and unlinked by the supervisor alone, attached by everybody else without tracking.

The last page of a segment says whose it is: magic, length, and the path of its run directory. Its supervisor holds a shared lock
on it (`flock`) for as long as it lives. So anybody can tell, from any directory or container, whether a segment is one of ours
and whether its session lives; what is not ours, or lives, is never unlinked.

Python's resource tracker knows of none of them. It unlinks by name when its process has died, which may be a moment after the
next session of that name began, and up to Python 3.12 also what its process merely attached (cpython issue 82300).
"""

from __future__ import annotations

import contextlib
import errno
import os
import pwd
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

MAGIC = b"LFSEGM1\0"
PREFIX = "lfp-"  # of every segment's name
PAGE = 4096
_OWNER = struct.Struct("<8sq")  # magic, length of the path that follows
_attach_lock = threading.Lock()


class WrongSegment(UserError, ValueError):
    """A segment that holds something else than its reader knows, or another version of it."""


class Segment(SharedMemory):
    """A segment that this process made. unlink removes that one, never another that has its name by now."""

    def __init__(self, name: str) -> None:
        with _untracked():
            super().__init__(name=name)
        self._identity = _identity(self._fd)  # type: ignore[attr-defined]
        lock(self._fd, shared=True)  # type: ignore[attr-defined]

    def unlink(self) -> None:
        """Takes the name away. Raises FileNotFoundError where it is no longer this segment's."""
        if shared_memory.identity(self.name) != self._identity:
            raise FileNotFoundError(errno.ENOENT, "another segment has that name", self.name)
        shared_memory.unlink(self.name)


def create(name: str, size_bytes: int, run_dir: Path | None = None) -> Segment:
    """A new segment of zeros for the session of run_dir, with room for size_bytes; a full /dev/shm is an error here.

    Raises UserError where there is no room, where the name is taken, and where none can be made at all.
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
    """What is at path, in words."""
    try:
        found = path.lstat()
    except OSError:
        return "something"
    kinds = {stat.S_IFDIR: "a directory", stat.S_IFLNK: "a link", stat.S_IFREG: "a file"}
    kind = kinds.get(stat.S_IFMT(found.st_mode), "something")
    if found.st_uid == os.getuid():
        return f"{kind} that lfpipe did not make"
    try:
        return f"{kind} of user {pwd.getpwuid(found.st_uid).pw_name}"
    except KeyError:
        return f"{kind} of user {found.st_uid}"


def attach(name: str) -> SharedMemory:
    """An existing segment, untracked. Raises FileNotFoundError where there is no such segment."""
    with _untracked():
        return SharedMemory(name=name)


@contextlib.contextmanager
def _untracked() -> Iterator[None]:
    """Switches registering with the resource tracker off for a moment."""
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
    """Raises WrongSegment, and closes memory, where it does not begin with magic or is shorter than what is said to be."""
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
    """Run directory of an open segment of this user's, empty for none; None where it is not one of ours."""
    found = os.fstat(fd)
    if not stat.S_ISREG(found.st_mode) or found.st_uid != os.getuid() or found.st_size < PAGE:
        return None
    page = os.pread(fd, PAGE, found.st_size - PAGE)
    magic, length = _OWNER.unpack_from(page)
    path = page[_OWNER.size : _OWNER.size + max(0, length)]
    return Path(os.fsdecode(path)) if magic == MAGIC and len(path) == length and b"\0" not in path else None


def _opened(prefix: str) -> Iterator[tuple[str, int, Path]]:
    """Name, descriptor and run directory of this user's segments whose names begin so."""
    for name in shared_memory.names(prefix):
        try:
            fd = shared_memory.open_readable(name)
        except OSError:
            continue  # it has just gone, or it is another user's, a link, ...
        try:
            owner = _owner(fd)
            if owner is not None:
                yield name, fd, owner
        except OSError:
            continue
        finally:
            os.close(fd)


def owned(prefix: str = PREFIX) -> dict[str, Path]:
    """This user's segments whose names begin so, living or not -> their run directories."""
    return {name: owner for name, _, owner in _opened(prefix)}


def abandoned(prefix: str = PREFIX) -> Iterator[tuple[str, Path]]:
    """Name and run directory of those whose supervisor is dead. Each may be unlinked, by its name, until the next is asked for:
    nobody else does so meanwhile, and so nobody can give the name to another segment.
    """
    for name, fd, owner in _opened(prefix):
        if lock(fd):
            with contextlib.suppress(FileNotFoundError):
                if shared_memory.identity(name) == _identity(fd):
                    yield name, owner


def living(prefix: str = PREFIX) -> list[str]:
    """Names of those whose supervisor lives."""
    return [name for name, fd, _ in _opened(prefix) if not lock(fd)]
