"""Timing of one turn, and a reference load that is the same in every build."""

import time
from collections.abc import Callable, Sequence

import cv2
import numpy as np

REFERENCE = "reference_ms"  # its key among the samples of a turn
_PLANE = np.random.default_rng(0).integers(0, 256, (256, 256), np.uint8)
_OUT = np.empty_like(_PLANE)
_Y, _X = (np.ascontiguousarray(a, np.float32) + np.float32(0.3) for a in np.mgrid[0:256, 0:256])


def times_ms(call: Callable[[], object], count: int) -> list[float]:
    """Time of each of count calls, in ms."""
    times = []
    for _ in range(count):
        start = time.perf_counter_ns()
        call()
        times.append((time.perf_counter_ns() - start) / 1e6)
    return times


def median_ms(call: Callable[[], object], count: int) -> float:
    """Median time of count calls, in ms."""
    return float(np.median(times_ms(call, count)))


def time_figures(times: Sequence[float], unit: str = "ms", scale: float = 1.0) -> dict[str, float]:
    """The figures time_UNIT (median) and time_p95_UNIT of times, multiplied by scale."""
    p50, p95 = np.percentile(times, (50, 95)) * scale
    return {f"time_{unit}": float(p50), f"time_p95_{unit}": float(p95)}


def reference_ms() -> float:
    """Speed of the machine right now: time in ms to resample a plane of 256x256, without any code of this package.

    Comparisons of two runs divide their times by this one. Then a slow hour of the machine does not look like a slow build.
    """
    return median_ms(lambda: cv2.remap(_PLANE, _X, _Y, cv2.INTER_LINEAR, _OUT, borderMode=cv2.BORDER_REPLICATE), 5)
