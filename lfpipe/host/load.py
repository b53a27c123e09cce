"""CPU time and memory of processes and threads, by psutil; whether there is a GPU and a desktop."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import psutil


@functools.lru_cache(64)
def _process(pid: int) -> psutil.Process:
    import psutil  # only for monitors: a stage starts faster without it

    return psutil.Process(pid)  # which takes longer than the query itself


def cpu_ns(pid: int) -> int:
    """User and system time of a process so far; 0 if it is gone."""
    import psutil

    try:
        times = _process(pid).cpu_times()
    except (psutil.Error, ValueError):
        return 0
    return int((times.user + times.system) * 1e9)


def activity(pid: int) -> tuple[int, bool]:
    """As `cpu_ns`, and whether the process waits for a disk or a network drive."""
    import psutil

    try:
        return cpu_ns(pid), _process(pid).status() == psutil.STATUS_DISK_SLEEP
    except (psutil.Error, ValueError):
        return 0, False


def rss_bytes(pid: int) -> int:
    """Resident memory of a process, including shared pages; 0 if it is gone."""
    import psutil

    try:
        return int(_process(pid).memory_info().rss)
    except (psutil.Error, ValueError):
        return 0


def has_gpu() -> bool:
    """Whether there is a rendering device; true if the system cannot report it."""
    return sys.platform != "linux" or any(Path("/dev/dri").glob("renderD*"))


def has_desktop() -> bool:
    """Whether windows need no display server named in the environment: on macOS and Windows."""
    return sys.platform in ("darwin", "win32")
