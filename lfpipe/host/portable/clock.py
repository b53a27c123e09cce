"""The clock that all processes share, and how long the machine has been suspended: unknown."""

from __future__ import annotations

import os
import time

# On Windows time.monotonic advances in steps of 16 ms up to Python 3.12; both clocks are the machine's, not the process's.
now_ns = time.perf_counter_ns if os.name == "nt" else time.monotonic_ns


def asleep_ns() -> int:
    """0: whether the monotonic clock goes on meanwhile differs between systems."""
    return 0
