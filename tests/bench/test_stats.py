"""Intervals of medians, Pareto fronts, and the true eyes between the rows of their table."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.bench.charts import front
from lfpipe.bench.inputs import eyes_at
from lfpipe.bench.results import MIN_SAMPLES, Row, Value
from lfpipe.bench.runner import median_interval
from lfpipe.bench.subjects import Chart
from lfpipe.sequence.eyes import Truth

COORDINATE = st.integers(0, 6).map(float)
CHART = Chart("Fake", "x", "y")


def test_interval_of_the_median_holds_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    for count in (MIN_SAMPLES, 9, 25):
        inside = 0
        for _ in range(400):
            low, high = median_interval(rng.exponential(1.0, count).tolist())
            inside += low <= math.log(2) <= high
        assert inside / 400 > 0.92, f"{count} samples: {inside} of 400"
    assert median_interval([3.0, 1.0, 2.0]) == (1.0, 3.0), "the range of too few"
    for count, low, high in ((6, 1, 6), (8, 1, 8), (10, 2, 9), (20, 6, 15), (25, 8, 18), (50, 18, 33)):  # as printed
        assert median_interval([float(k) for k in range(count, 0, -1)]) == (low, high), "ranks of the sign test"


@given(st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=30))
def test_front_is_what_nothing_beats(points: list[tuple[float, float]]) -> None:
    rows = [Row(str(k), {"x": Value(x), "y": Value(y)}) for k, (x, y) in enumerate(points)]
    best = [(row.value("x"), row.value("y")) for row in front(rows, CHART)]
    assert best == sorted(best)
    for x, y in best:
        assert not any((a <= x and b < y) or (a < x and b <= y) for a, b in points)
    for x, y in points:
        assert any(a <= x and b <= y for a, b in best)


def test_what_ties_within_its_noise_is_beaten_by_the_better_error() -> None:
    """Three settings of one code differ by 0.2 % of time and 2 % of noise: only the most exact is on the front."""
    points = [(10.02, 5.0), (10.0, 6.0), (9.98, 7.0), (1.0, 9.0)]
    rows = [Row(str(k), {"x": Value(x, x - 0.1, x + 0.1), "y": Value(y)}) for k, (x, y) in enumerate(points)]
    assert [row.name for row in front(rows, CHART)] == ["3", "0"]


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=12), st.integers(0, 2**32))
def test_truth_between_its_rows_is_between_them(heights: list[float], seed: int) -> None:
    t_ns = np.cumsum(np.random.default_rng(seed).integers(1_000_000, 80_000_000, len(heights)))
    eyes = np.repeat(np.array(heights)[:, None], 4, axis=1).reshape(-1, 2, 2)
    truth = Truth(t_ns, eyes, np.ones(len(heights), bool))
    assert np.array_equal(eyes_at(truth, t_ns), eyes)
    middle = eyes_at(truth, (t_ns[0] + t_ns[1]) / 2)
    assert np.allclose(middle, (eyes[0] + eyes[1]) / 2)
    outside = eyes_at(truth, [t_ns[0] - 1e9, t_ns[-1] + 1e9])
    assert np.array_equal(outside, eyes[[0, -1]])
