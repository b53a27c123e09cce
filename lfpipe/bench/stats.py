"""Intervals of medians, a signed-rank test, Pareto fronts."""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

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


def bootstrap_interval(values: Sequence[float], level: float = 0.95, draws: int = 2000, seed: int = 1) -> tuple[float, float]:
    """Percentile interval of the median of values resampled with replacement (Efron 1979)."""
    sample: NDArray[np.float64] = np.asarray(values, np.float64)
    drawn = np.random.default_rng(seed).integers(0, len(sample), (draws, len(sample)))
    low, high = np.quantile(np.median(sample[drawn], axis=1), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


@lru_cache(maxsize=64)
def _rank_sums(n: int) -> NDArray[np.float64]:
    """Probability of each sum of a random half of the ranks 1..n."""
    chance = np.ones(1)
    for rank in range(1, n + 1):
        chance = np.concatenate([chance, np.zeros(rank)]) / 2 + np.concatenate([np.zeros(rank), chance]) / 2
    return chance


def p_above(values: Sequence[float]) -> float:
    """Probability of values (n,) this high if they were symmetric around 0: Wilcoxon's signed ranks (1945), exact, one-sided.

    A small result means that their median is above 0. No normal distribution is assumed; an outlier counts by its rank.
    """
    sample = np.asarray(values, np.float64)
    ranks = np.empty(len(sample))
    ranks[np.argsort(np.abs(sample), kind="stable")] = np.arange(1, len(sample) + 1)
    return float(_rank_sums(len(sample))[int(ranks[sample > 0].sum()) :].sum())


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other beats in both coordinates (less is better), from left to right."""
    front: list[int] = []
    for k in sorted(range(len(points)), key=lambda k: points[k]):
        if not front or points[k][1] < points[front[-1]][1]:
            front.append(k)
    return front
