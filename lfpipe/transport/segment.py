"""Shared-memory segments: made and unlinked by the supervisor alone, attached by everybody else without tracking."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import threading
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

from lfpipe.errors import UserError

SHM_DIR = Path("/dev/shm")
_attach_lock = threading.Lock()


def create(name: str, size_bytes: int) -> SharedMemory:
    """A new segment whose pages exist: a full /dev/shm is an error here and never a SIGBUS at the first write later.

    Raises UserError with the sizes where there is no room, and where none can be made at all.
    """
    try:
        memory = SharedMemory(name=name, create=True, size=size_bytes)
    except OSError as error:
        remedy = f"a tmpfs at {SHM_DIR} that you may write to: docker run --shm-size=128m, or mount one there"
        raise UserError(f"{SHM_DIR}: no shared memory can be made: {error.strerror}", remedy) from None
    try:
        os.posix_fallocate(memory._fd, 0, size_bytes)  # type: ignore[attr-defined]
    except OSError as error:
        memory.close()
        memory.unlink()
        if error.errno not in (errno.ENOSPC, errno.ENOMEM):
            raise
        usage = shutil.disk_usage(SHM_DIR)
        raise UserError(
            f"{SHM_DIR} has {usage.free / 1e6:.1f} MB free of {usage.total / 1e6:.1f} MB, {name} needs {size_bytes / 1e6:.1f} MB",
            f"mount -o remount,size={max(64, 2 * size_bytes >> 20)}m {SHM_DIR}, or docker run --shm-size=128m, "
            "or smaller camera.width_px and camera.height_px",
        ) from None
    return memory


def attach(name: str) -> SharedMemory:
    """An existing segment, untracked: up to Python 3.12 the tracker of an unrelated process would unlink it at its exit
    (cpython issue 82300), so registering is switched off for the moment of attaching.

    Raises FileNotFoundError where there is no such segment.
    """
    with _attach_lock:
        register = resource_tracker.register
        resource_tracker.register = lambda name, rtype: None
        try:
            return SharedMemory(name=name)
        finally:
            resource_tracker.register = register


def buffer(memory: SharedMemory) -> memoryview:
    """The bytes of an open segment."""
    assert memory.buf is not None, f"{memory.name} is closed"
    return memory.buf


def unlink_all(prefix: str) -> list[str]:
    """Removes every segment whose name starts with prefix; returns their names. For what a killed session left."""
    gone = []
    for path in SHM_DIR.glob(f"{prefix}*"):
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
            gone.append(path.name)
    return gone
