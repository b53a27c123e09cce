"""CPU time and memory of processes, by psutil."""

from __future__ import annotations

import functools
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


def rss_bytes(pid: int) -> int:
    """Resident memory of a process, including shared pages; 0 if it is gone."""
    import psutil

    try:
        return int(_process(pid).memory_info().rss)
    except (psutil.Error, ValueError):
        return 0
