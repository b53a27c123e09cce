"""The clock that all processes share, and the time for which the machine has been suspended."""

import time

now_ns = time.monotonic_ns  # CLOCK_MONOTONIC


def asleep_ns() -> int:
    """The time for which the machine has been suspended since it started: the monotonic clock stops then."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()
