"""Medians with their intervals, and fronts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FEWEST = 6  # samples for a 95 % interval of the median from order statistics alone: 1 - 2 / 2**6 = 0.97


def median_interval(samples: Sequence[float]) -> tuple[float, float]:
    """95 % interval of the median by order statistics: no assumption about the distribution. Infinite below FEWEST samples."""
    n = len(samples)
    if n < FEWEST:
        return -math.inf, math.inf
    ordered, below, k = sorted(samples), 0.0, 0
    while below + math.comb(n, k) / 2**n <= 0.025:
        below += math.comb(n, k) / 2**n
        k += 1
    return ordered[k - 1], ordered[n - k]


def noise(samples: Sequence[float]) -> float:
    """Width of the median's interval over the median: infinite with too few samples, 0 for equal ones."""
    low, high = median_interval(samples)
    return (high - low) / abs(middle) if (middle := float(np.median(samples)) if len(samples) else 0.0) else math.inf


def bootstrap_interval(groups: Sequence[Sequence[float]], level: float, draws: int = 4000, seed: int = 1) -> tuple[float, float]:
    """Interval of the median of all values when groups are drawn with replacement, and within each its values.

    What shares a process or a second of motion is one group: samples in it are not independent.
    """
    rng = np.random.default_rng(seed)
    arrays = [np.asarray(group, np.float64) for group in groups]
    count, longest = len(arrays), max(len(group) for group in arrays)
    if longest == 1:
        flat: NDArray[np.float64] = np.concatenate(arrays)
        medians = np.median(flat[rng.integers(0, count, (draws, count))], axis=1)
    else:
        medians = np.empty(draws)
        for k in range(draws):
            chosen = [arrays[i] for i in rng.integers(0, count, count)]
            medians[k] = np.median(np.concatenate([group[rng.integers(0, len(group), len(group))] for group in chosen]))
    low, high = np.quantile(medians, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other beats in both coordinates (less is better), from left to right."""
    front: list[int] = []
    for k in sorted(range(len(points)), key=lambda k: points[k]):
        if not front or points[k][1] < points[front[-1]][1]:
            front.append(k)
    return front
