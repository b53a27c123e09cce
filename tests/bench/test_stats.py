"""Intervals, fronts, and the interpolated truth."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from lfpipe.bench.eye_path import HEAD, EyePath
from lfpipe.bench.stats import MIN_SAMPLES, front, median_interval
from lfpipe.errors import UserError
from lfpipe.sequence.eyes import Truth

COORDINATE = st.integers(0, 6).map(float)


def test_interval_of_the_median_holds_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    for count in (MIN_SAMPLES, 9, 25):
        inside = 0
        for _ in range(400):
            low, high = median_interval(rng.exponential(1.0, count).tolist())
            inside += low <= math.log(2) <= high
        assert inside / 400 > 0.92, f"{count} samples: {inside} of 400"
    assert median_interval([3.0, 1.0, 2.0]) == (1.0, 3.0), "the range of too few"


@pytest.mark.parametrize(("count", "low", "high"), [(6, 1, 6), (8, 1, 8), (10, 2, 9), (20, 6, 15), (25, 8, 18), (50, 18, 33)])
def test_interval_of_the_median_is_that_of_the_tables(count: int, low: int, high: int) -> None:
    """Ranks as printed for the sign test, 95 %, two-sided."""
    samples = [float(k) for k in range(count, 0, -1)]
    assert median_interval(samples) == (low, high)


@given(st.lists(st.tuples(COORDINATE, COORDINATE), min_size=1, max_size=30))
def test_front_is_what_nothing_beats(points: list[tuple[float, float]]) -> None:
    best = [points[k] for k in front([(x, 0.0, y, 0.0) for x, y in points])]
    assert best == sorted(best)
    for x, y in best:
        assert not any((a <= x and b < y) or (a < x and b <= y) for a, b in points)
    for x, y in points:
        assert any(a <= x and b <= y for a, b in best)


@given(st.lists(st.floats(-1e3, 1e3).map(lambda y: round(y, 3)), min_size=3, max_size=12), st.integers(0, 2**32))
def test_truth_between_its_rows_is_the_monotone_cubic(heights: list[float], seed: int) -> None:
    t_ns = np.cumsum(np.random.default_rng(seed).integers(1_000_000, 80_000_000, len(heights)))
    eyes = np.repeat(np.array(heights)[:, None], 4, axis=1)
    states = [True] * len(heights)
    truth = EyePath(Truth(t_ns, eyes.reshape(-1, 2, 2), np.array(states), np.array(states)))
    between = np.linspace(t_ns[1], t_ns[-2], 50)
    wanted = PchipInterpolator(t_ns / 1e9, heights)(between / 1e9)
    if len(heights) > 4:  # its ends are its own
        inner = (between > t_ns[1]) & (between < t_ns[-2])
        assert np.allclose(truth.at(between)[inner][:, 0, 0], wanted[inner], atol=1e-6)
    assert np.allclose(truth.at(t_ns).reshape(-1, 4), eyes, rtol=0, atol=1e-9)
    everywhere = truth.at(np.linspace(t_ns[0] - 1e9, t_ns[-1] + 1e9, 200))
    assert everywhere.min() >= min(heights) - 1e-9 and everywhere.max() <= max(heights) + 1e-9


def test_truth_knows_since_when(tmp_path: Path) -> None:
    rows = [(k, k * 10, 1, 1, 0, 0, int(k != 2), "still" if k < 4 else "reach") for k in range(6)]
    path = tmp_path / "truth.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([HEAD, *rows])
    truth = EyePath.read(path)
    assert truth.visible_ns.tolist() == [0, 0, -1, 30, 30, 30]
    assert truth.still_ns.tolist() == [0, 0, -1, 30, -1, -1]


@pytest.mark.parametrize("text", ["", "t_ns\n1\n2\n", "\0\xff", ",".join(HEAD) + "\n0,0,1,1,0,0,1,still\n", "nonsense"])
def test_a_file_that_is_no_truth_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(UserError, match=r"truth\.csv"):
        EyePath.read(path)
