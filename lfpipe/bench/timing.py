"""Timing of one turn, and a load that stays the same from build to build."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np

REFERENCE = "reference_ms"  # the key of it among the samples of a turn
_PLANE = np.random.default_rng(0).integers(0, 256, (256, 256), np.uint8)
_OUT = np.empty_like(_PLANE)
_Y, _X = (np.ascontiguousarray(a, np.float32) + np.float32(0.3) for a in np.mgrid[0:256, 0:256])


def median_ms(call: Callable[[], object], count: int) -> float:
    """Median time of count calls, in ms."""
    return statistics.median(times_ms(call, count))


def times_ms(call: Callable[[], object], count: int) -> list[float]:
    """Time of each of count calls, in ms."""
    found = []
    for _ in range(count):
        start = time.perf_counter_ns()
        call()
        found.append((time.perf_counter_ns() - start) / 1e6)
    return found


def reference_ms() -> float:
    """What the machine does right now, in ms: one resampling of a 256x256 plane, nothing of this package in it.

    Two runs are compared by times over this one, so that a slower hour of the machine is not taken for a slower build.
    """
    return median_ms(lambda: cv2.remap(_PLANE, _X, _Y, cv2.INTER_LINEAR, _OUT, borderMode=cv2.BORDER_REPLICATE), 5)
