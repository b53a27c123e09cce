"""Times of a call."""

import time
from collections.abc import Callable, Sequence

import numpy as np


def times_ms(call: Callable[[], object], count: int) -> list[float]:
    """Time of each of count calls, in ms."""
    times = []
    for _ in range(count):
        start = time.perf_counter_ns()
        call()
        times.append((time.perf_counter_ns() - start) / 1e6)
    return times


def time_figures(times: Sequence[float], unit: str = "ms", scale: float = 1.0) -> dict[str, float]:
    """The figures time_UNIT (median) and time_p95_UNIT of times, multiplied by scale."""
    p50, p95 = np.percentile(times, (50, 95)) * scale
    return {f"time_{unit}": float(p50), f"time_p95_{unit}": float(p95)}
