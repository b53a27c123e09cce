"""The clock that all processes share; the time for which the machine has been suspended is unknown."""

import os
import time

# On Windows time.monotonic advances in steps of 16 ms up to Python 3.12; both clocks are the machine's, not the process's.
now_ns = time.perf_counter_ns if os.name == "nt" else time.monotonic_ns


def asleep_ns() -> int:
    """0: systems differ on whether the monotonic clock continues during suspension."""
    return 0
