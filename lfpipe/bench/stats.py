"""Intervals of medians, Pareto fronts."""

import math
from collections.abc import Sequence

import numpy as np

MIN_SAMPLES = 6  # for a 95 % interval of the median from order statistics: 1 - 2 / 2**6 = 0.97


def median_interval(samples: Sequence[float]) -> tuple[float, float]:
    """95 % interval of the median by order statistics, for any distribution. Infinite below MIN_SAMPLES samples."""
    n = len(samples)
    if n < MIN_SAMPLES:
        return -math.inf, math.inf
    tail = np.cumsum([math.comb(n, k) / 2**n for k in range(n // 2)])
    k = int(np.searchsorted(tail, 0.025, side="right"))
    ordered = sorted(samples)
    return ordered[k - 1], ordered[n - k]


def noise(samples: Sequence[float]) -> float:
    """Width of the interval of the median over the median: infinite with too few samples, 0 for equal ones."""
    low, high = median_interval(samples)
    return (high - low) / abs(middle) if (middle := float(np.median(samples)) if len(samples) else 0.0) else math.inf


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other beats in both coordinates (less is better), from left to right."""
    front: list[int] = []
    for k in sorted(range(len(points)), key=lambda k: points[k]):
        if not front or points[k][1] < points[front[-1]][1]:
            front.append(k)
    return front
