"""The clock that all processes share, and the time for which the machine has been suspended."""

import time

from lfpipe.host import WINDOWS

# CLOCK_MONOTONIC; on Windows it advances in steps of 16 ms up to Python 3.12. Both clocks are the machine's, not the process's.
now_ns = time.perf_counter_ns if WINDOWS else time.monotonic_ns


def asleep_ns() -> int:
    """The time for which the machine has been suspended since it started, where the monotonic clock stops then; else 0."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return 0 if clock is None else time.clock_gettime_ns(clock) - time.monotonic_ns()
