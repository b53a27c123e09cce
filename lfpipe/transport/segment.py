"""Shared-memory segments: only the supervisor creates and unlinks them; all others attach without tracking.

A segment names its owner, and whether that lives can be seen from outside: `lfpipe.host.shared_memory` says how.
"""

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.host import shared_memory
from lfpipe.host.shared_memory import SHM_DIR, Mapping
from lfpipe.host.shared_memory import Segment as Segment

PREFIX = "lfp-"  # of every segment's name
PAGE = 4096


class WrongSegment(UserError, ValueError):
    """A segment with other contents, or another version, than its reader expects."""


def create(name: str, size_bytes: int, run_dir: Path | None = None) -> Segment:
    """Creates a segment of size_bytes zeros for the session of run_dir. Allocates its pages, so a full /dev/shm is an error here.

    Raises UserError if there is no room, if the name is in use, or if shared memory cannot be created at all.
    """
    whole_bytes = -(-size_bytes // PAGE) * PAGE
    try:
        return shared_memory.create(name, whole_bytes, os.fsencode(run_dir) if run_dir else b"")
    except FileExistsError:
        raise UserError(
            f"{SHM_DIR / name}: {_kind(SHM_DIR / name)} is in the way", "remove it, or use another --session name"
        ) from None
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.ENOMEM):
            raise UserError(f"{SHM_DIR}: cannot create shared memory: {error.strerror}", shared_memory.WRITABLE) from None
        free, total = shared_memory.room()
        raise UserError(
            f"{SHM_DIR} has {free / 1e6:.1f} MB free of {total / 1e6:.1f} MB; {name} needs {whole_bytes / 1e6:.1f} MB",
            f"{shared_memory.more_room(whole_bytes)}, or smaller camera.width_px and camera.height_px",
        ) from None


def _kind(path: Path) -> str:
    """Describes what is at path."""
    try:
        found = path.lstat()
    except OSError:
        return "something"
    kinds = {stat.S_IFDIR: "a directory", stat.S_IFLNK: "a link", stat.S_IFREG: "a file"}
    kind = kinds.get(stat.S_IFMT(found.st_mode), "something")
    if found.st_uid == os.getuid():
        return f"{kind} that lfpipe did not create"
    return f"{kind} of user {found.st_uid}"


def buffer(memory: Mapping) -> memoryview:
    """The bytes of an open segment."""
    assert memory.buf is not None, f"{memory.name} is closed"
    return memory.buf


def check(memory: Mapping, magic: bytes, what: str, size_bytes: int) -> None:
    """Raises WrongSegment, and closes memory, if it does not begin with magic or is too short. what: its name in words."""
    found, size = bytes(buffer(memory)[: len(magic)]), memory.size
    if found == magic and size >= size_bytes:
        return
    memory.close()
    said = f"begins with {found!r}" if found != magic else f"has {size} bytes of {size_bytes}"
    raise WrongSegment(
        f"{memory.name}: not a {what} of this version (magic {magic!r}): it {said}",
        "end that session with the version of lfpipe that started it, then start it again",
    )


def attach(name: str) -> Mapping:
    """Opens an existing segment. Raises FileNotFoundError."""
    return Mapping(name)


def owned(prefix: str = PREFIX) -> dict[str, Path]:
    """Segments of this user whose names begin with prefix, of living and dead sessions: name -> run directory."""
    return shared_memory.owned(prefix)


def abandoned(prefix: str = PREFIX) -> Iterator[tuple[str, Path]]:
    """Yields name and run directory of segments whose supervisor is dead. The caller may unlink each by name before it takes the
    next. Until then, no other process unlinks it, so the name cannot pass to another segment.
    """
    return shared_memory.abandoned(prefix)
