"""The mapping from eyes to viewpoints: formula, handedness, rim, hysteresis, and whatever a tracker
may deliver.
"""

import itertools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Render
from lfpipe.render.synthesis.viewpoint import ViewSolver, limited

ANY = st.floats(allow_nan=True, allow_infinity=True)
COUNTS = st.integers(1, 30)
USUAL = st.floats(-2000, 2000)
METHODS = st.sampled_from(["nearest", "blend", "warp2"])


def solver(
    rows: int = 9, cols: int = 9, alpha_px: float = 12.0, method: Any = "warp2", **render: Any
) -> ViewSolver:
    return ViewSolver(rows, cols, Render(**render), alpha_px, (320.0, 240.0), method)


def soft_clamp(value: float, count: int, reach: float) -> float:
    return limited(value, 0.0, count - 1.0, reach)


SENSELESS = st.sampled_from([0.0, -0.0, math.nan, math.inf, 1e-320])


@given(
    st.tuples(ANY, ANY, ANY, ANY),
    st.floats(1e-9, 1e9) | SENSELESS,
    COUNTS,
    COUNTS,
    st.floats(0, 16),
    METHODS,
)
def test_view_solver_is_finite_and_within_reach(
    p: tuple[float, float, float, float],
    alpha_px: float,
    rows: int,
    cols: int,
    reach: float,
    method: str,
) -> None:
    found = solver(rows, cols, alpha_px, method, extrapolate_views=reach).views(p)
    assert found[0][0] == found[1][0], "one row for both eyes"
    reach = reach if method == "warp2" else 0.0
    for row, col in found:
        assert -reach <= row <= rows - 1 + reach
        assert -reach <= col <= cols - 1 + reach


@given(st.floats(-50, 50), st.floats(1e-6, 1), st.integers(1, 20), st.floats(0.01, 16))
def test_limited_is_exact_inside_and_never_jumps_or_turns_back(
    value: float, step: float, count: int, reach: float
) -> None:
    here, there = soft_clamp(value, count, reach), soft_clamp(value + step, count, reach)
    if 0 <= value <= count - 1:
        assert here == value
    assert 0 <= there - here <= step * (1 + 1e-9) + 1e-12
    assert -reach <= here <= count - 1 + reach
    if -reach <= value and value + step <= count - 1 + reach:
        assert there - here >= 0.4 * step - 1e-12, "it never freezes: tanh rises by 0.42 at 1"


@given(st.lists(st.floats(-0.09, 0.09), min_size=1, max_size=50), st.floats(-3, 3))
def test_view_solver_nearest_has_hysteresis(noise: list[float], place: float) -> None:
    snapping = solver(method="nearest", extrapolate_views=0.0)
    views = [snapping.views((320 - 12 * (place + n), 240 + 12 * (n - place)) * 2)[0] for n in noise]
    for steps in zip(*views, strict=True):  # rows, then columns
        assert all(step == round(step) for step in steps)
        assert sum(a != b for a, b in itertools.pairwise(steps)) <= 1


CENTRES = st.tuples(st.floats(-500, 1500), st.floats(-500, 1500))


@given(
    CENTRES,
    st.tuples(USUAL, USUAL, st.floats(-200, 200)),
    st.floats(2, 100),
    st.integers(1, 12),
    st.integers(2, 12),
)
def test_dragged_is_the_nearest_neutral_position_that_holds_the_eyes(
    centre: tuple[float, float],
    head: tuple[float, float, float],
    alpha_px: float,
    rows: int,
    cols: int,
) -> None:
    x, y, half_px = head
    eyes = (x + half_px, y, x - half_px, y)
    one = ViewSolver(rows, cols, Render(), alpha_px, centre)
    cx, cy = one.dragged(centre, eyes)
    room_x = max((cols - 1) / 2 * alpha_px - abs(half_px), 0.0)
    room_y = (rows - 1) / 2 * alpha_px
    assert cx == pytest.approx(sorted((x - room_x, centre[0], x + room_x))[1], abs=1e-6)
    assert cy == pytest.approx(sorted((y - room_y, centre[1], y + room_y))[1], abs=1e-6)
    again = one.dragged((cx, cy), eyes)
    assert again == pytest.approx((cx, cy), abs=1e-6), "there it stays"
