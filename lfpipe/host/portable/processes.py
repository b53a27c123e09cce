"""Processes: cores and niceness, if the system has them."""

import contextlib
import os
from collections.abc import Iterable
from multiprocessing.process import BaseProcess

import psutil

SPAWNED = "multiprocessing.spawn"  # in the command line of every stage


def usable_cores() -> list[int]:
    """The cores that this process may run on."""
    return list(range(os.cpu_count() or 1))


def scheduling(pid: int) -> tuple[list[int], int]:
    """Cores that a process may run on, and its niceness, 0 on Windows, which has classes; ([], 0) if it is gone."""
    cores: list[int] = []
    nice = 0
    with contextlib.suppress(psutil.Error, AttributeError, OSError, ValueError):
        process = psutil.Process(pid)
        nice = int(process.nice()) if os.name == "posix" else 0
        cores = usable_cores()
        cores = sorted(process.cpu_affinity())
    return cores, nice


def set_scheduling(cores: Iterable[int], nice: int | None) -> None:
    """Moves this process to cores, to all if empty or if the system decides, and sets its niceness. Raises PermissionError."""
    process = psutil.Process()
    if cores := list(cores):
        with contextlib.suppress(AttributeError):  # macOS
            process.cpu_affinity(cores)
    if nice is not None and os.name == "posix":
        try:
            process.nice(nice)
        except psutil.AccessDenied as error:
            raise PermissionError(str(error)) from None


def yield_to_others() -> None:
    """Does nothing: only Linux supports it."""


def set_up(name: str) -> None:
    """Does nothing: a process keeps its name and its allocator."""


def sentinels(process: BaseProcess) -> list[int]:
    """None: a poller of sockets accepts no process handle. The end is noticed after the poller's timeout."""
    return []


def resume_stage(pid: int) -> None:
    """Resumes a stopped stage; does nothing if it is gone, because another program may have its number."""
    with contextlib.suppress(psutil.Error, AttributeError, ValueError):
        process = psutil.Process(pid)
        if any(SPAWNED in word for word in process.cmdline()):
            process.resume()
