"""Whether a process lives, by its number and start time: numbers are reused."""

import functools
import os

import psutil

SAME_START_S = 60.0  # on some systems, setting the clock moves the reported start time


@functools.cache
def _started_s(pid: int) -> int:
    return int(psutil.Process(pid).create_time())


def own_mark() -> str:
    """The mark of this process, for `lives`."""
    return f"{os.getpid()}-{_started_s(os.getpid())}"


def lives(mark: str) -> bool:
    """Whether the process of a mark lives; False for an invalid mark."""
    try:
        pid, started_s = (int(part) for part in mark.split("-"))
        process = psutil.Process(pid)
        same = abs(float(process.create_time()) - started_s) < SAME_START_S
        return same and str(process.status()) != psutil.STATUS_ZOMBIE
    except psutil.AccessDenied:
        return True
    except (ValueError, OverflowError, psutil.Error):
        return False
