"""Times of a call, intervals of medians, Pareto fronts."""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

MIN_SAMPLES = 6  # for a 95 % interval of the median from order statistics: 1 - 2 / 2**6 = 0.97


def median_interval(samples: Sequence[float]) -> tuple[float, float]:
    """95 % interval of the median by order statistics, for any distribution; the range below MIN_SAMPLES samples."""
    ordered, n = sorted(samples), len(samples)
    if n < MIN_SAMPLES:
        return ordered[0], ordered[-1]
    tail = np.cumsum([math.comb(n, k) / 2**n for k in range(n // 2)])
    k = int(np.searchsorted(tail, 0.025, side="right"))
    return ordered[k - 1], ordered[n - k]


def front(points: Sequence[tuple[float, float, float, float]]) -> list[int]:
    """Indices of the points (x, half interval of x, y, half interval of y) on the Pareto front, from left to right.

    Less is better. What differs by less than both intervals together ties: a point is beaten by one that is better in one
    coordinate and better or equal in the other.
    """

    def better(a: tuple[float, ...], b: tuple[float, ...], k: int) -> bool:
        return b[k] - a[k] > a[k + 1] + b[k + 1]

    def beats(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
        x, y = better(a, b, 0), better(a, b, 2)
        return (x and not better(b, a, 2)) or (y and not better(b, a, 0))

    kept = [k for k, b in enumerate(points) if not any(beats(a, b) for a in points)]
    return sorted(kept, key=lambda k: points[k])


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
