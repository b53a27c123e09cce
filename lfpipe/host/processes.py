"""Processes: their load, the cores they run on, their niceness; and what a stage asks of the system for itself."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import signal
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import psutil

PR_SET_TIMERSLACK = 29
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_BYTES = 32 << 20  # the most that glibc accepts; a frame of 4K has 25 MB


@functools.lru_cache(64)
def _process(pid: int) -> psutil.Process:
    import psutil  # for monitors alone: a stage starts sooner without it

    return psutil.Process(pid)  # which takes longer than what it is asked for


def cpu_ns(pid: int) -> int:
    """User and system time of a process so far; 0 where it is gone."""
    import psutil

    try:
        times = _process(pid).cpu_times()
    except (psutil.Error, ValueError):
        return 0
    return int((times.user + times.system) * 1e9)


def rss_bytes(pid: int) -> int:
    """Resident memory of a process, shared pages included; 0 where it is gone."""
    import psutil

    try:
        return int(_process(pid).memory_info().rss)
    except (psutil.Error, ValueError):
        return 0


def usable_cores() -> list[int]:
    """The cores that this process may run on."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def scheduling(pid: int) -> tuple[list[int], int]:
    """Cores that a process may run on, and its niceness; ([], 0) where it is gone."""
    try:
        return (sorted(os.sched_getaffinity(pid)), os.getpriority(os.PRIO_PROCESS, pid)) if pid > 0 else ([], 0)
    except OSError:
        return [], 0


def set_scheduling(cores: Iterable[int], nice: int | None) -> None:
    """Moves this process to cores, all where none are named, with that niceness. Raises PermissionError."""
    if cores := list(cores):
        os.sched_setaffinity(0, cores)
    if nice is not None:
        os.setpriority(os.PRIO_PROCESS, 0, nice)


def yield_to_others() -> None:
    """Gives way to the other processes of this core whenever they want it; as before where the system cannot."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def set_up(name: str) -> None:
    """Gives this process a name that tools show, sleeps that end on time, and an allocator that keeps memory for the next
    frame: pictures given back to the kernel and faulted in again, page by page, cost 1 ms a frame of 640x480.
    """
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(name[:15])
    with contextlib.suppress(AttributeError, OSError):  # another C library: as it is
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        libc.mallopt(M_TRIM_THRESHOLD, 2 * KEPT_BYTES)
        libc.prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)  # up to 50 us late otherwise


def name_of(pid: int) -> str:
    """The name of a process, as `set_up` gave it; empty where it is gone."""
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except OSError:
        return ""


def resume(pid: int) -> None:
    """Lets a stopped process continue; nothing where it is gone."""
    with contextlib.suppress(OSError):
        os.kill(pid, signal.SIGCONT)
