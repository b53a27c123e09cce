"""Medians with their intervals, and fronts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

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


def bootstrap_interval(values: Sequence[float], level: float = 0.95, draws: int = 2000, seed: int = 1) -> tuple[float, float]:
    """Percentile interval of the median of values drawn anew with replacement (Efron 1979)."""
    flat: NDArray[np.float64] = np.asarray(values, np.float64)
    drawn = np.random.default_rng(seed).integers(0, len(flat), (draws, len(flat)))
    low, high = np.quantile(np.median(flat[drawn], axis=1), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


@lru_cache(maxsize=64)
def _rank_sums(n: int) -> NDArray[np.float64]:
    """Chance of each sum of a random half of the ranks 1..n."""
    chance = np.ones(1)
    for rank in range(1, n + 1):
        chance = np.concatenate([chance, np.zeros(rank)]) / 2 + np.concatenate([np.zeros(rank), chance]) / 2
    return chance


def above(values: Sequence[float]) -> float:
    """How likely values (n,) lie as high as this by chance where they are spread evenly around 0: Wilcoxon's signed ranks (1945),
    exact, one-sided. Small: their middle is above 0. Nothing need be normally distributed; an outlier counts by its rank."""
    flat = np.asarray(values, np.float64)
    ranks = np.empty(len(flat))
    ranks[np.argsort(np.abs(flat), kind="stable")] = np.arange(1, len(flat) + 1)
    return float(_rank_sums(len(flat))[int(ranks[flat > 0].sum()) :].sum())


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other beats in both coordinates (less is better), from left to right."""
    front: list[int] = []
    for k in sorted(range(len(points)), key=lambda k: points[k]):
        if not front or points[k][1] < points[front[-1]][1]:
            front.append(k)
    return front
