"""Processes: the cores they run on, their niceness; and what a stage asks of the system for itself."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
from collections.abc import Iterable
from multiprocessing.process import BaseProcess
from pathlib import Path

PR_SET_TIMERSLACK = 29
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_BYTES = 32 << 20  # the most that glibc accepts; a frame of 4K has 25 MB


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


def sentinels(process: BaseProcess) -> list[int]:
    """Descriptors for a poller that are readable once a process has ended; none where a poller cannot take them."""
    return [process.sentinel]


def resume_stage(pid: int) -> None:
    """Lets a stopped stage continue; nothing where it is gone, and another program has its number by now."""
    with contextlib.suppress(OSError):
        if Path(f"/proc/{pid}/comm").read_text().startswith("lfpipe-"):
            os.kill(pid, signal.SIGCONT)
