"""Disparity of a view from all that stands around it."""

import numpy as np
import pytest

from lfpipe.scene.disparity import estimate_disparity, luma, neighbour_indices, refined
from lfpipe.scene.optical_flow import Grey
from tests.bench.inputs import wall


def _grey(views: np.ndarray) -> dict[tuple[int, int], Grey]:
    return {(r, c): luma(views[0, r, c]) for r in range(views.shape[1]) for c in range(views.shape[2])}


@pytest.mark.parametrize("wrong_px", [0.4, -0.3])
def test_refinement_pulls_a_map_to_where_all_neighbours_agree(wrong_px: float) -> None:
    grey = _grey(wall(3, 3, 96).views)
    neighbours = [(grey[r, c], float(r - 1), float(c - 1)) for r, c in neighbour_indices(1, 1, 3, 3)]
    found = np.full((96, 96), 2 + wrong_px, np.float32)
    for _ in range(2):
        found = refined(grey[1, 1], neighbours, found)
    inner = np.abs(found - 2)[8:-8, 8:-8]
    assert np.median(inner) < 0.05 and np.percentile(inner, 95) < 0.2


def test_refinement_leaves_flat_pictures_alone() -> None:
    flat = np.full((64, 64), 90, np.uint8)
    found = refined(flat, [(flat, 0.0, 1.0), (flat, 1.0, 0.0)], np.full((64, 64), 1.7, np.float32))
    np.testing.assert_allclose(found, 1.7, atol=1e-4)


def test_a_view_at_the_rim_looks_at_the_diagonal_too() -> None:
    assert set(neighbour_indices(0, 0, 2, 2)) == {(0, 1), (1, 0), (1, 1)}
    assert set(neighbour_indices(1, 1, 3, 3)) == {(0, 1), (1, 0), (1, 2), (2, 1)}
    assert set(neighbour_indices(0, 2, 1, 5)) == {(0, 1), (0, 3)}


def test_four_corners_of_a_wall_are_met_within_a_tenth_of_a_pixel() -> None:
    found = estimate_disparity(wall(2, 2, 96).views[0])
    assert found is not None
    assert np.abs(found - 2)[:, :, 4:-4, 4:-4].mean() < 0.1
