"""Processes: cores, niceness, and settings of a stage's own process."""

import contextlib
import ctypes
import os
import signal
from collections.abc import Iterable
from multiprocessing.process import BaseProcess
from pathlib import Path

from lfpipe.host import WINDOWS

PR_SET_TIMERSLACK = 29
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_BYTES = 32 << 20  # the maximum of glibc; a 4K frame has 25 MB


def usable_cores() -> list[int]:
    """The cores that this process may run on."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def scheduling(pid: int) -> tuple[list[int], int]:
    """Cores that a process may run on, and its niceness; ([], 0) if it is gone."""
    try:
        nice = os.getpriority(os.PRIO_PROCESS, pid) if pid > 0 else 0
        return (sorted(os.sched_getaffinity(pid)) if pid > 0 else [], nice)
    except (OSError, AttributeError):  # macOS and Windows place processes themselves
        return [], 0


def set_scheduling(cores: Iterable[int], nice: int | None) -> None:
    """Moves this process to cores, or to all if empty, and sets its niceness, where the system can. Raises PermissionError."""
    if (cores := list(cores)) and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
    if nice is not None and not WINDOWS:
        os.setpriority(os.PRIO_PROCESS, 0, nice)


def yield_to_others() -> None:
    """Yields the core to other processes whenever they need it; no effect if the system cannot do this."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def set_up(name: str) -> None:
    """Sets a process name for tools, precise sleeps, and an allocator that keeps memory for the next frame: returning pictures to
    the kernel and faulting them in again costs 1 ms per frame of 640x480.
    """
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(name[:15])
    with contextlib.suppress(AttributeError, OSError, TypeError):  # another C library: leave it unchanged
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        libc.mallopt(M_TRIM_THRESHOLD, 2 * KEPT_BYTES)
        libc.prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)  # up to 50 us late otherwise


def sentinels(process: BaseProcess) -> list[int]:
    """Descriptors for a poller that become readable when a process ends; none if a poller cannot use them."""
    return [] if WINDOWS else [process.sentinel]


def resume_stage(pid: int) -> None:
    """Resumes a stopped stage; does nothing if it is gone, because another program may have its number."""
    with contextlib.suppress(OSError):
        if Path(f"/proc/{pid}/comm").read_text().startswith("lfpipe-"):
            os.kill(pid, signal.SIGCONT)
