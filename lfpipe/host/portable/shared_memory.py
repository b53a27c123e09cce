"""Named shared memory from `multiprocessing`, and a folder of the user in which every segment is registered.

On Windows a segment lives as long as a process has it open, elsewhere until it is unlinked. Not every system can list segments,
so an entry of the registry names the creator of each: the run directory, the process, and a unique number. Entries change only
while the registry is locked.
"""

import contextlib
import errno
import json
import os
import secrets
import stat
import tempfile
from collections.abc import Iterator
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import psutil

from lfpipe.host.file_lock import waited_for
from lfpipe.host.paths import exists
from lfpipe.host.portable.liveness import lives, own_mark
from lfpipe.host.segment_names import names_in
from lfpipe.host.untracked import untracked
from lfpipe.host.users import user_id, user_word

SHM_DIR = Path(tempfile.gettempdir()) / f"lfpipe-{user_word()}-segments"
WHERE = "shared memory"  # for messages
WRITABLE = f"a folder {SHM_DIR} that you may write to"
_LOCK = "registry"


class Segment(SharedMemory):
    """A segment that this process created. `unlink` never removes another segment that has taken its name."""

    def __init__(self, name: str, size_bytes: int, number: int) -> None:
        with untracked():
            super().__init__(name, create=True, size=size_bytes)
        self._number = number

    def unlink(self) -> None:
        """Removes the name. Raises FileNotFoundError if it is no longer this segment's."""
        if identity(self.name) != (0, self._number):
            raise FileNotFoundError(errno.ENOENT, "another segment has that name", self.name)
        unlink(self.name)


def _make_registry() -> None:
    """Creates the folder. Raises PermissionError if it is another user's or a link."""
    SHM_DIR.mkdir(mode=0o700, parents=True, exist_ok=True)
    if SHM_DIR.is_symlink() or SHM_DIR.stat().st_uid != user_id():
        raise PermissionError(errno.EPERM, "not a directory of yours", str(SHM_DIR))


def create(name: str, size_bytes: int, run_dir: bytes) -> Segment:
    """Creates a segment of at least size_bytes zeros for the session of run_dir; its pages are allocated if the system supports
    it.

    Raises OSError, FileExistsError if the name is taken.
    """
    _make_registry()
    entry, number = SHM_DIR / name, secrets.randbits(62)
    text = json.dumps({"run_dir": os.fsdecode(run_dir), "owner": own_mark(), "number": number})
    with waited_for(SHM_DIR / _LOCK):
        if exists(entry) or entry.is_symlink():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(entry))
        part = SHM_DIR / ".new"
        part.write_text(text)
        part.replace(entry)
        try:
            try:
                made = Segment(name, size_bytes, number)
            except FileExistsError:  # unregistered: its entry was lost
                _unlink_memory(name)
                made = Segment(name, size_bytes, number)
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(made._fd, 0, size_bytes)  # type: ignore[attr-defined]
        except BaseException:
            _unlink_memory(name)
            entry.unlink()
            raise
    return made


def _unlink_memory(name: str) -> None:
    with contextlib.suppress(FileNotFoundError), untracked():
        memory = SharedMemory(name)
        memory.close()
        memory.unlink()


def _entry(name: str) -> dict[str, Any]:
    """Raises FileNotFoundError if there is no valid entry."""
    try:
        path = SHM_DIR / name
        kind = path.lstat()
        if not stat.S_ISREG(kind.st_mode) or kind.st_uid != user_id():
            raise ValueError(name)
        found = json.loads(path.read_text())
        return {"run_dir": Path(found["run_dir"]), "owner": str(found["owner"]), "number": int(found["number"])}
    except (ValueError, KeyError, TypeError, OSError):
        raise FileNotFoundError(errno.ENOENT, "no such segment", name) from None


def identity(name: str) -> tuple[int, int]:
    """Identifies the segment that currently has this name. Raises FileNotFoundError."""
    return 0, _entry(name)["number"]


def unlink(name: str) -> None:
    """Removes the name; processes that map the memory keep it. Raises FileNotFoundError."""
    _unlink_memory(name)
    (SHM_DIR / name).unlink()


def room() -> tuple[int, int]:
    """Free and total bytes for segments: the machine's memory."""
    memory = psutil.virtual_memory()
    return int(memory.available), int(memory.total)


def more_room(needed_bytes: int) -> str:
    """The remedy for too little room."""
    return "close other programs"


def owned(prefix: str) -> dict[str, Path]:
    """Segments of this user whose names begin with prefix, of living and dead sessions: name -> run directory."""
    found = {}
    for name in names_in(SHM_DIR, prefix):
        with contextlib.suppress(FileNotFoundError):
            found[name] = _entry(name)["run_dir"]
    return found


def abandoned(prefix: str) -> Iterator[tuple[str, Path]]:
    """Yields name and run directory of segments whose creator is dead. The caller may unlink each by name before it takes the
    next: until then no other process unlinks it, so the name cannot pass to another segment.
    """
    for name in names_in(SHM_DIR, prefix):
        with contextlib.suppress(FileNotFoundError):
            if lives(_entry(name)["owner"]):
                continue
            with waited_for(SHM_DIR / _LOCK):
                entry = _entry(name)
                if not lives(entry["owner"]):
                    yield name, entry["run_dir"]
