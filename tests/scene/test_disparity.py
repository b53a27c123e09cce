"""Disparity of a view from its neighbours."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from lfpipe.scene.disparity import (
    confirmed_share,
    estimate_disparity,
)
from lfpipe.scene.lightfield import UNKNOWN
from lfpipe.scene.optical_flow import flow
from tests.scene import made


@pytest.mark.parametrize("axis", [0, 1])
def test_maps_of_a_pair_confirm_each_other_where_they_lead_back(axis: int) -> None:
    steps = np.full((2, 60, 80), 32, np.int8)  # 4 px of the pictures
    assert confirmed_share(steps, 0.125, axis) == 1.0
    steps[0, :, :20] = UNKNOWN
    assert 0.7 < confirmed_share(steps, 0.125, axis) < 0.8, "what is unknown confirms nothing"
    steps[1, :30] = -32
    assert 0.3 < confirmed_share(steps, 0.125, axis) < 0.5
    assert confirmed_share(np.full_like(steps, UNKNOWN), 0.125, axis) == 0


def planar(*grid: float) -> np.ndarray:
    return made.views(*map(int, grid[:4]), *grid[4:]).transpose(0, 1, 4, 2, 3)


FIVE = planar(5, 5, 96, 128, 2.0, -1.0)
# views, the true disparity of one in the middle, and how far off this share of it is at most
KNOWN: dict[str, tuple[np.ndarray, np.ndarray, float, float]] = {
    "of its own step, of a subset": (FIVE[::2, ::2], 2 * made.middle_disparity(), 0.25, 0.5),
    "across 40 px between views": (
        planar(3, 3, 192, 192, 40.0, 0.0),
        made.middle_disparity(192, 192, 40.0, 0.0),
        2.0,
        0.9,
    ),
}


@pytest.mark.parametrize("kind", KNOWN)
def test_estimate_disparity_of_known_views(kind: str) -> None:
    views, truth, most_px, share = KNOWN[kind]
    found = estimate_disparity(views)
    assert found is not None and found.shape[:2] == views.shape[:2]
    middle = found[len(views) // 2, views.shape[1] // 2]
    # false where it is unknown
    assert np.mean(np.abs(middle - truth[::2, ::2]) < most_px) > share


def test_flow_is_the_same_after_a_small_picture() -> None:
    """OpenCV lowers the scale of an engine for pictures below 48 px, and leaves it so."""
    pair = made.views(1, 2)[0, ..., 1]
    with ThreadPoolExecutor(1) as thread:  # with an engine of its own
        before, _, after = thread.map(
            lambda pictures: flow(*pictures), (pair, pair[:, :32, :32], pair)
        )
    assert np.array_equal(before, after)


def test_cameras_off_the_grid_are_divided_by_their_true_distance() -> None:
    painted = made.texture(192, 256, 4)
    steps = np.array([0.0, 1.4, 2.0])  # the middle camera stands 0.4 of a step to the right
    views = np.array(
        [[painted[40:136, 40 + round(5 * s) : 168 + round(5 * s)] for s in steps]]
    ).transpose(0, 1, 4, 2, 3)
    offsets = np.zeros((1, 3, 2), np.float32)
    offsets[0, 1, 1] = 0.4
    known, blind = estimate_disparity(views, offsets), estimate_disparity(views)
    assert known is not None and blind is not None
    assert np.isnan(known).mean() < 0.01 and np.nanmean(np.abs(known - 5)) < 0.1
    assert np.nanmean(np.abs(blind - 5)) > 1, "if it is not marked as unknown"


def _drawn(pattern: np.ndarray, shift_px: float, opacity: np.ndarray | None = None) -> np.ndarray:
    """3x3 views, uint8 (3, 3, 1, S, S), of a pattern that moves by shift_px per view, before a
    textured wall that does not move where opacity (0 to 1) is lower.
    """
    random = np.random.default_rng(1)
    side = len(pattern) - 2 * MARGIN
    wall = cv2.GaussianBlur(random.normal(size=pattern.shape), (0, 0), 1.2)
    wall = 125 + wall / wall.std() * 22

    def moved(picture: np.ndarray, row: int, col: int) -> np.ndarray:
        by = np.array([[1, 0, -MARGIN - shift_px * col], [0, 1, -MARGIN - shift_px * row]])
        return cv2.warpAffine(picture, by, (side, side), flags=cv2.INTER_CUBIC)

    views = np.empty((3, 3, 1, side, side), np.uint8)
    for row, col in np.ndindex(3, 3):
        view = moved(pattern, row - 1, col - 1)
        if opacity is not None:
            share = np.clip(moved(opacity, row - 1, col - 1), 0, 1)
            view = share * view + (1 - share) * wall[MARGIN:-MARGIN, MARGIN:-MARGIN]
        views[row, col, 0] = np.clip(np.rint(view + random.normal(0, 0.7, view.shape)), 0, 255)
    return views


def _middle_errors(views: np.ndarray, shift_px: float, inside: np.ndarray) -> np.ndarray:
    """Errors of the middle view's disparity, px, where inside, (S, S), is true."""
    found = estimate_disparity(views)
    assert found is not None
    return np.asarray(np.abs(found[1, 1] - shift_px)[inside[::2, ::2]])


MARGIN = 40
Y, X = np.mgrid[: 160 + 2 * MARGIN, : 160 + 2 * MARGIN].astype(np.float64)


@pytest.mark.parametrize("shift_px", [1.5, 3.0])
@pytest.mark.parametrize("upright", [True, False])
def test_striped_patch_has_its_disparity_in_both_directions(upright: bool, shift_px: float) -> None:
    """A neighbour along the stripes matches at any disparity, so it must not decide."""
    stripes = 128 + 80 * np.sign(np.sin(2 * np.pi * (X if upright else Y) / 12))
    opacity = ((np.abs(X - 120) < 34) & (np.abs(Y - 120) < 34)) * 1.0
    inside = (opacity > 0)[MARGIN:-MARGIN, MARGIN:-MARGIN]
    inside = cv2.erode(inside.astype(np.uint8), np.ones((17, 17))).astype(bool)
    errors = _middle_errors(
        _drawn(cv2.GaussianBlur(stripes, (0, 0), 0.7), shift_px, opacity), shift_px, inside
    )
    assert np.nanmedian(errors) <= 0.1 and np.nanpercentile(errors, 95) <= 1.0
    assert np.isnan(errors).mean() < 0.05
