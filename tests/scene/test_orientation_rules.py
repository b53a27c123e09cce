"""The rules of the order of views, each by its definition."""

from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.scene.orientation import ALIKE, Axis, Orientation, examine_axis, orient, same_way
from lfpipe.scene.source import Turn
from tests.scene import made
from tests.scene.made import TURNS, turned
from tests.scene.made import as_source as source

AUTO = config.Scene()


def axis(disparity: np.ndarray, reliable: np.ndarray | None = None) -> Axis:
    whole = np.ones(disparity.shape, bool) if reliable is None else reliable
    return Axis(
        sideways=True,
        disparity=disparity.astype(np.float32),
        reliable=whole,
        along_px=1.0,
        across_px=0.0,
        right=0,
        wrong=0,
    )


@given(st.floats(0.2, 5), st.booleans(), st.integers(0, 99))
def test_axes_agree_as_their_disparities_correlate(scale: float, reverse: bool, seed: int) -> None:
    values = np.random.default_rng(seed).normal(0, 1, (20, 30))
    sign = -1 if reverse else 1
    assert same_way(axis(values), axis(sign * scale * values + 3)) == pytest.approx(sign, abs=1e-4)
    assert (
        abs(
            same_way(
                axis(values), axis(np.random.default_rng(seed + 100).normal(0, 1, values.shape))
            )
        )
        < ALIKE
    )
    few = np.zeros(values.shape, bool)
    few.ravel()[:199] = True
    assert same_way(axis(values, few), axis(values)) == 0.0
    few.ravel()[199] = True
    assert same_way(axis(values), axis(values, few)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("first", "second", "alike"),
    [
        (1.0, 1.0, 0.9),
        (1.0, -1.0, -0.9),
        (1.0, 1.9, 0.9),
        (1.0, 2.1, 0.0),
        (1.0, 0.45, 0.0),
        (0.25, 0.25, 0.0),
        (-2.0, -1.5, 0.9),
    ],
)
def test_a_flat_wall_moves_as_one_and_by_as_much_along_both_axes(
    first: float, second: float, alike: float
) -> None:
    rng = np.random.default_rng(0)
    walls = [
        axis(at + rng.normal(0, noise, (20, 30))) for at, noise in ((first, 1e-3), (second, 1e-3))
    ]
    assert same_way(*walls) == pytest.approx(alike, abs=0.15)
    constant = axis(np.full((20, 30), first)), axis(np.full((20, 30), second))
    assert same_way(*constant) == alike
    assert same_way(axis(np.full((20, 30), first)), axis(np.full((20, 30), 2 * first))) == 0.0, (
        "by twice as much"
    )
    leaning = axis(first + rng.normal(0, 0.05 * abs(first), (20, 30)))
    other = axis(leaning.disparity * second / first + rng.normal(0, 0.03 * abs(second), (20, 30)))
    correlated = np.corrcoef(leaning.disparity.ravel(), other.disparity.ravel())[0, 1]
    assert same_way(leaning, other) == pytest.approx(correlated), (
        "what correlates says more than a mean"
    )
    rough = [axis(at + rng.normal(0, 0.4 * abs(at), (20, 30))) for at in (first, second)]
    assert abs(same_way(*rough)) < 0.3, "no wall: it varies"


@pytest.mark.parametrize("sideways", [True, False])
@pytest.mark.parametrize("px", [-1.5, 0.5, 2.0])
def test_an_axis_is_measured_by_what_moves(sideways: bool, px: float) -> None:
    grid = made.views(1, 7, 96, 128, px, px)[0, ..., 1]
    views = grid if sideways else grid.swapaxes(1, 2)
    found = examine_axis(lambda k: views[k], len(views))
    assert found is not None and found.sideways is sideways
    assert found.along_px == pytest.approx(
        abs(px), rel=0.2, abs=0.1
    ) and found.across_px < 0.1 + 0.1 * abs(px)
    assert np.median(found.disparity[found.reliable]) == pytest.approx(px, rel=0.1)
    assert (
        examine_axis(lambda k: views[k], 1) is None
        and examine_axis(lambda k: views[k], 2) is not None
    )


@pytest.mark.parametrize(("px", "by"), [(0.4, "flow"), (0.0, "nothing")])
def test_motion_of_less_than_half_a_pixel_is_seen(px: float, by: str) -> None:
    order = orient(source(made.views(5, 5, 96, 128, px, -px)), AUTO)
    assert order.by == by and ("scene.flip" in order.undecided) == (by == "nothing")


def test_views_that_move_across_their_line_are_no_line() -> None:
    wall = made.texture(192, 256, 4)
    steep = np.array([[wall[4 * k : 96 + 4 * k, 4 * k : 128 + 4 * k] for k in range(7)]])
    order = orient(source(steep), AUTO)
    assert order.by == "nothing" and "across the line" in order.reason and not order.half_turn_sure


def test_a_grid_whose_columns_stand_still_is_a_doubtful_one() -> None:
    line = made.views(1, 7)
    order = orient(source(np.repeat(line, 3, axis=0)), AUTO)
    assert (order.by, order.turn.transpose) == (
        "flow",
        False,
    ) and "whether the grid is one" in order.undecided


TRUTH = {(2, 2): made.middle_disparity}


@pytest.mark.parametrize("turn", TURNS, ids=str)
def test_true_disparity_corrects_a_layout(turn: Turn) -> None:
    """The map of the middle view lands on the neighbouring views in one order only."""
    whole = source(turned(made.views(5, 5), turn), turn=Turn(), turn_by="names", truth=TRUTH)
    asked = attrs.evolve(
        whole,
        read=lambda f, r, c: (
            whole.read(f, r, c) if (r, c) != (3, 3) else pytest.fail("no neighbour")
        ),
    )
    order = orient(asked, AUTO)
    assert (
        order.turn == turn
        and order.by == ("layout" if turn == Turn() else "truth")
        and order.sure
        and order.half_turn_sure
    )
    assert orient(attrs.evolve(asked, rendered=True), AUTO).turn == Turn(), (
        "not asked where the program drew it"
    )
    assert orient(attrs.evolve(asked, missing=frozenset({(2, 3)})), AUTO).by != "truth", (
        "a neighbour is missing"
    )
    assert orient(attrs.evolve(asked, truth={(0, 2): made.middle_disparity}), AUTO).by != "truth", (
        "not of the middle view"
    )
    for shape in ((1, 5), (5, 1)):
        middle = {(shape[0] // 2, shape[1] // 2): made.middle_disparity}
        line = source(made.views(*shape)[::-1, ::-1], turn=Turn(), turn_by="names", truth=middle)
        assert orient(line, AUTO).by != "truth", "no view below, or none beside"


def test_a_map_that_matches_nowhere_changes_nothing() -> None:
    flat = {(2, 2): lambda: np.zeros((96, 128), np.float32)}
    assert orient(
        source(made.views(5, 5), turn=Turn(rows=True), turn_by="names", truth=flat), AUTO
    ).turn == Turn(rows=True)
    both = {
        (1, 1): lambda: -made.middle_disparity(),
        **TRUTH,
        (3, 3): lambda: -made.middle_disparity(),
    }
    assert orient(
        source(made.views(5, 5)[::-1], turn=Turn(), turn_by="names", truth=both), AUTO
    ).turn == Turn(rows=True)


@pytest.mark.parametrize(
    ("words", "turn", "by"),
    [
        ({"flip": "rows"}, Turn(rows=True), "override"),
        ({"flip": "none", "transpose": "yes"}, Turn(transpose=True), "override"),
        ({"flip": "both"}, Turn(True, True), "override"),
        ({"flip": "none"}, Turn(), "override"),
        ({"transpose": "yes"}, Turn(transpose=True), "override"),
        # a setting that changes nothing is none
        ({"transpose": "no"}, Turn(), "flow"),
    ],
)
def test_the_users_word_wins(words: dict[str, Any], turn: Turn, by: str) -> None:
    order = orient(source(made.views(5, 5)), config.Scene(**words))
    assert (order.turn, order.by) == (turn, by) and order.depth is not None
    assert (order.detected is None) == (by == "flow")


def test_a_doubt_of_the_layout_is_kept() -> None:
    order = orient(source(made.views(5, 5), doubt="perhaps 3x3"), AUTO)
    assert order.undecided == "perhaps 3x3" and not order.sure and not order.half_turn_sure
    assert orient(source(made.views(1, 1), doubt="x"), AUTO).turn == Turn()


@pytest.mark.parametrize("turn", TURNS, ids=str)
def test_a_pack_leaves_the_half_turn_to_the_session(turn: Turn) -> None:
    order = Orientation(turn=turn, by="flow", reason="")
    assert order.half_turn is turn.cols
    assert order.packed == (Turn(not turn.rows, False, turn.transpose) if turn.cols else turn)
    assert order.truth_sign == (-1 if turn.cols else 1)
    asked = Orientation(turn=turn, by="override", reason="", detected=Turn())
    assert (asked.half_turn, asked.packed) == (False, turn)
    assert asked.truth_sign == (
        0 if turn.transpose or turn.rows != turn.cols else -1 if turn.cols else 1
    )


@pytest.mark.parametrize(("near_px", "far_px"), [(2.0, -1.0), (1.0, 0.5)])
def test_depth_is_that_of_the_middle_view_in_either_way(near_px: float, far_px: float) -> None:
    grid = made.views(5, 5, 96, 128, near_px, far_px)
    true = {(2, 2): lambda: made.middle_disparity(96, 128, near_px, far_px)}
    for more in (
        {"turn": Turn(), "turn_by": "names", "turn_firm": True, "truth": true},
        {"turn": Turn(), "turn_by": "names"},
        {},
    ):
        depth = orient(source(grid, **more), AUTO).depth
        assert depth is not None
        assert depth.max_px == pytest.approx(near_px, abs=0.4)
        assert depth.min_px == pytest.approx(far_px, abs=0.4)
    column = orient(source(grid[:, 2:3], turn=Turn(), turn_by="names", turn_firm=True), AUTO).depth
    assert column is not None and column.max_px == pytest.approx(near_px, abs=0.4)
    turned = orient(
        source(grid[::-1, ::-1], turn=Turn(True, True), turn_by="names", turn_firm=True), AUTO
    )
    assert turned.depth is not None and turned.depth.max_px == pytest.approx(-far_px, abs=0.4), (
        "of the pack, without the half-turn"
    )
