"""The method that a scene deserves."""

import attrs
import numpy as np
import pytest

from lfpipe.render.scoring import choose_method, left_out, thinned
from tests.render import rendered


def test_views_far_apart_are_never_cross_faded_by_choice() -> None:
    method, scores = choose_method(rendered.field(5, 5, scale=6.0))
    assert method != "blend" and "blend" not in scores
    pair = attrs.evolve(rendered.field(1, 2, scale=6.0), disparity=None)
    assert choose_method(pair)[0] == "nearest" and choose_method(rendered.field(1, 2, depth=False))[0] == "blend"


@pytest.mark.parametrize(("rows", "cols"), [(5, 5), (1, 5), (5, 1), (2, 5), (4, 4), (3, 6)])
def test_a_scene_with_depth_is_warped(rows: int, cols: int) -> None:
    method, scores = choose_method(rendered.field(rows, cols, 96, 96, scale=2.0))
    assert method.startswith("warp") and set(scores) == {"nearest", "blend", "warp", "warp2"}
    assert scores["nearest"] < scores["blend"] < scores["warp"]


def test_wrong_disparities_are_found_out_and_a_scene_that_never_changes_gets_the_cheapest() -> None:
    field = rendered.field(5, 5, 96, 96)
    assert field.disparity is not None
    wrong = attrs.evolve(field, disparity=np.random.default_rng(0).permuted(field.disparity, axis=-1)[..., ::-1, :])
    assert choose_method(wrong)[0] == "blend"
    still = attrs.evolve(field, views=np.broadcast_to(field.views[:, :1, :1], field.views.shape))
    assert choose_method(attrs.evolve(still, disparity=np.zeros_like(field.disparity)))[0] == "nearest"


@pytest.mark.parametrize(("rows", "cols", "method"), [(1, 1, "nearest"), (1, 2, "warp2"), (2, 2, "warp2")])
def test_grids_too_small_for_leaving_out(rows: int, cols: int, method: str) -> None:
    assert choose_method(rendered.field(rows, cols)) == (method, {})


def test_left_out_views_are_present_inside_and_not_kept() -> None:
    present = np.ones((6, 9), bool)
    present[1, 1] = False
    field = attrs.evolve(rendered.field(6, 9), present=present)
    places = left_out(field, 7)
    assert len(places) == 7 and thinned(field).views.shape[1:3] == (3, 5)
    assert all((row % 2 or col % 2) and row <= 4 and present[row, col] for row, col in places)
