"""Disparity of a view from all that stands around it."""

import numpy as np
import pytest

from lfpipe.scene.disparity import (
    estimate_disparity,
    luma,
    neighbour_indices,
    quantised,
    refined,
    scale_for,
)
from lfpipe.scene.optical_flow import SMALLEST_PX
from tests.bench.inputs import wall
from tests.scene import made


@pytest.mark.parametrize("wrong_px", [0.4, -0.3])
def test_refinement_pulls_a_map_to_where_all_neighbours_agree_and_leaves_flat_pictures_alone(
    wrong_px: float,
) -> None:
    views = wall(3, 3, 96).views[0]
    neighbours = [
        (luma(views[r, c]), float(r - 1), float(c - 1)) for r, c in neighbour_indices(1, 1, 3, 3)
    ]
    found = np.full((96, 96), 2 + wrong_px, np.float32)
    for _ in range(2):
        found = refined(luma(views[1, 1]), neighbours, found)
    inner = np.abs(found - 2)[8:-8, 8:-8]
    assert np.median(inner) < 0.05 and np.percentile(inner, 95) < 0.2
    flat = np.full((64, 64), 90, np.uint8)
    found = refined(flat, [(flat, 0.0, 1.0), (flat, 1.0, 0.0)], np.full((64, 64), 1.7, np.float32))
    np.testing.assert_allclose(found, 1.7, atol=1e-4)


def test_scales_hold_the_range() -> None:
    assert scale_for(-3.1, 2.7) == 1 / 16
    for low, high in ((-14.6, 8.4), (-1.0, 30.0)):
        scale = scale_for(low, high)
        ends = quantised(np.array([low, high], np.float32), scale) * np.float32(scale)
        assert np.allclose(ends, (low, high), atol=scale / 2 + 1e-6)


def test_four_corners_of_a_wall_are_met_within_a_tenth_of_a_pixel() -> None:
    found = estimate_disparity(wall(2, 2, 96).views[0])
    assert found is not None
    assert np.abs(found - 2)[:, :, 4:-4, 4:-4].mean() < 0.1


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


def test_estimate_disparity_needs_two_views_that_are_not_too_small() -> None:
    assert estimate_disparity(FIVE[:1, :1]) is None
    assert estimate_disparity(FIVE[:, :, :, : SMALLEST_PX - 1]) is None


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
