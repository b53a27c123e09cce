"""Disparity of live views: against the exact one, over time, and for cameras that are turned."""

import attrs
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfpipe.live.field import Estimator, aligned
from lfpipe.live.records import MAX_VIEWS, cut, map_size, pairs_in_need, views_of
from lfpipe.render.synthesis.viewpoint import view_weights
from lfpipe.scene.lightfield import LightField
from tests.live import made
from tests.render import rendered

PAIR = [((0, 0), (0, 1))]


def exact_error_px(found: NDArray[np.void], view: tuple[int, int], field: LightField) -> float:
    """Median difference to the exact disparity of a view."""
    assert field.disparity is not None
    exact = np.asarray(field.disparity[0][view]) * field.disparity_scale_px
    return float(np.median(np.abs(made.maps_of(found)[view] - exact)))


@given(
    row=st.floats(-0.4, 4.4),
    cols=st.tuples(st.floats(-0.4, 5.4), st.floats(-0.4, 5.4)),
)
def test_pairs_in_need_hold_every_view_that_a_warp_uses(
    row: float, cols: tuple[float, float]
) -> None:
    live = made.source(5, 6)
    pairs = pairs_in_need(live, [(row, col) for col in cols])
    views = views_of(pairs)
    assert len(views) <= MAX_VIEWS
    for col in cols:
        used = view_weights("warp2", (row, col), 5, 6)
        assert {(view.row, view.col) for view in used} <= set(views)


@pytest.mark.parametrize("shape", [(1, 2), (2, 1), (3, 3)])
def test_estimate_is_the_disparity_of_the_views(shape: tuple[int, int]) -> None:
    field = rendered.field(*shape, 96, 128, scale=2.0)
    live = made.source(*shape)
    pairs = pairs_in_need(live, [((shape[0] - 1) / 2, (shape[1] - 1) / 2)])
    estimator = Estimator(live, aligns=False)
    frame = made.frame_of(field)
    for coarse in (False, True):
        found = estimator.estimate(frame, pairs, coarse)
        maps = made.maps_of(found)
        assert set(maps) == set(views_of(pairs))
        for view, disparity in maps.items():
            assert disparity.shape == map_size(live)
            assert exact_error_px(found, view, field) < 0.3
    assert found["low_px"] == pytest.approx(field.disparity_min_px, abs=0.5)
    assert found["high_px"] == pytest.approx(field.disparity_max_px, abs=0.5)


@pytest.mark.parametrize("size_px", [(48, 48), (49, 63), (200, 50), (300, 48)])
def test_views_of_any_size_are_estimated(size_px: tuple[int, int]) -> None:
    """A search of flow at scales that a picture is too small for ended the process."""
    live = made.source(1, 2, height_px=size_px[1], width_px=size_px[0])
    for high in (256, 1):
        frame = np.random.default_rng(1).integers(0, high, (*live.frame_px[::-1], 3), np.uint8)
        estimator = Estimator(live, aligns=True)
        for coarse in (False, True):
            assert np.isfinite(estimator.estimate(frame, PAIR, coarse)["scale_px"])


def test_estimate_follows_an_object_at_once() -> None:
    live = made.source()
    near, far = (made.frame_of(rendered.field(1, 2, 96, 128, scale=scale)) for scale in (3.0, 1.0))
    field = rendered.field(1, 2, 96, 128, scale=1.0)
    estimator = Estimator(live, aligns=False)
    for _ in range(3):
        estimator.estimate(near, PAIR)
    found = [estimator.estimate(far, PAIR) for _ in range(2)][-1]
    assert exact_error_px(found, (0, 0), field) < 0.3


@pytest.mark.parametrize(
    ("turn_deg", "scale", "lower_px"), [(0.8, 1.0, 0.0), (-1.5, 1.01, 4.0), (0.0, 0.985, -6.0)]
)
def test_alignment_finds_how_the_right_camera_is_turned(
    turn_deg: float, scale: float, lower_px: float
) -> None:
    field = rendered.field(1, 2, 240, 320, scale=1.0)
    live = made.source(height_px=240, width_px=320)
    frame = made.frame_of(field)
    middle = (319 / 2, 239 / 2)
    turned = cv2.getRotationMatrix2D(middle, -turn_deg, scale)
    turned[1, 2] += lower_px
    right = cut(frame, live, (0, 1))
    right[:] = cv2.warpAffine(right.copy(), turned, (320, 240), borderMode=cv2.BORDER_REPLICATE)
    estimator = Estimator(live, aligns=True)
    for _ in range(40):
        found = estimator.estimate(frame, PAIR)
    assert estimator.alignment is not None
    placed = estimator.alignment.placement(swapped=False)
    assert placed.rotation_deg == pytest.approx(turn_deg, abs=0.15)
    assert placed.scale == pytest.approx(scale, abs=0.003)
    assert placed.height_px == pytest.approx(lower_px, abs=0.5)
    again = Estimator(attrs.evolve(live, placement=placed), aligns=True)
    first = again.estimate(frame, PAIR)
    assert exact_error_px(first, (0, 0), field) < 0.5, "aligned from the first frame on"
    assert exact_error_px(found, (0, 0), field) < 0.5
    straight = aligned(right, estimator.alignment.bend)
    inside = np.s_[40:-40, 40:-40]
    error = np.abs(straight[inside].astype(int) - made.frame_of(field)[:, 320:][inside])
    assert np.median(error) < 12


def test_cameras_in_the_other_order_are_swapped() -> None:
    near = rendered.field(1, 2, 96, 128, scale=2.0)  # from -2 to 4 px; moved by 6: all positive
    live = made.source()
    frame = made.frame_of(near)
    frame[:, 128:] = np.roll(frame[:, 128:], -6, axis=1)
    other = np.hstack([frame[:, 128:], frame[:, :128]])
    estimator = Estimator(live, aligns=True)
    for _ in range(40):
        found = estimator.estimate(other, PAIR)
    assert estimator.swapped and found["high_px"] > 0
    right = Estimator(live, aligns=True)
    for _ in range(40):
        right.estimate(frame, PAIR)
    assert not right.swapped


def test_views_of_different_scenes_are_noticed() -> None:
    live = made.source(1, 2, 240, 320)
    left = rendered.field(1, 2, 240, 320, scale=2.0)
    frame = made.frame_of(left)
    other = frame.copy()
    other[:, 320:] = frame[::-1, 639:319:-1]  # upside down, and mirrored
    estimator = Estimator(live, aligns=True)
    for number in range(1, 8):
        estimator.estimate(other, PAIR)
        assert estimator.strange_frames == number
    for _ in range(8):
        estimator.estimate(frame, PAIR)
    assert estimator.strange_frames == 0
