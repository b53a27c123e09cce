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


def test_four_corners_of_a_wall_are_met_within_a_tenth_of_a_pixel() -> None:
    found = estimate_disparity(wall(2, 2, 96).views[0])
    assert found is not None
    assert np.abs(found - 2)[:, :, 4:-4, 4:-4].mean() < 0.1


def test_scales_hold_the_range() -> None:
    assert scale_for(-3.1, 2.7) == 1 / 16
    for low, high in ((-14.6, 8.4), (-1.0, 30.0)):
        scale = scale_for(low, high)
        ends = quantised(np.array([low, high], np.float32), scale) * np.float32(scale)
        assert np.allclose(ends, (low, high), atol=scale / 2 + 1e-6)


def test_disparity_of_a_subset_of_views_is_per_its_own_step() -> None:
    grid = made.views(5, 5).transpose(0, 1, 4, 2, 3)
    found = estimate_disparity(grid[::2, ::2])
    assert found is not None and found.shape == (3, 3, 48, 64)
    assert np.median(np.abs(found[1, 1] - 2 * made.middle_disparity()[::2, ::2])) < 0.25
    assert (
        estimate_disparity(grid[:1, :1])
        is estimate_disparity(grid[:, :, :, : SMALLEST_PX - 1])
        is None
    )


def test_disparity_across_40_px_between_views() -> None:
    views = made.views(3, 3, 192, 192, near_px=40.0, far_px=0.0).transpose(0, 1, 4, 2, 3)
    disparity = estimate_disparity(views)
    assert disparity is not None
    off = np.abs(disparity[1, 1] - made.middle_disparity(192, 192, 40.0, 0.0)[::2, ::2])
    right = off < 2  # false where it is unknown
    assert right.mean() > 0.9


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
