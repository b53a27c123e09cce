"""Overlap, suppression and crops of the face detector."""

import cv2
import numpy as np
import pytest

from lfpipe.track.detector import SAME, overlap, suppressed
from lfpipe.track.network import Roi, mapped, portable_warp, warp


def test_overlap_is_intersection_over_union() -> None:
    a, others = (0.0, 0.0, 2.0, 2.0), [(0.0, 0.0, 2.0, 2.0), (1.0, 0.0, 3.0, 2.0), (2.0, 2.0, 3.0, 3.0), (0.5, 0.5, 0.5, 0.5)]
    assert [overlap(a, other) for other in others] == pytest.approx([1, 1 / 3, 0, 0])
    assert overlap(others[3], others[3]) == 0  # no area, no overlap, no division by zero
    here = (100.0, 100.0, 200.0, 200.0)
    faces = (130.0, 110.0, 230.0, 210.0), (180.0, 100.0, 280.0, 200.0), (140.0, 140.0, 160.0, 160.0)
    assert [overlap(here, face) > SAME for face in faces] == [True, False, False], "the same where it was and of its size"


def test_suppression_averages_by_score_and_keeps_the_best_score() -> None:
    rows = np.array([[0, 0, 10, 10, 1.0], [1, 0, 11, 10, 4.0], [50, 50, 60, 60, 7.0], [3, 3, 3, 3, 9.0]])
    out = suppressed(rows, np.array([0.6, 0.9, 0.7, 0.5]))
    assert [score for _, score in out] == [0.9, 0.7, 0.5]
    np.testing.assert_allclose(out[0][0], (0.6 * rows[0] + 0.9 * rows[1]) / 1.5)
    np.testing.assert_allclose(out[2][0], rows[3])


@pytest.mark.parametrize("angle", [0.0, 0.5, -1.3, 3.0])
def test_crop_shows_what_the_map_says(angle: float) -> None:
    image = np.zeros((100, 100, 3), np.uint8)
    image[40:44, 60:64] = 255
    roi = Roi(62.0, 42.0, 20.0, angle)
    crop = roi.crop(image, roi.matrix(60), 60, 0)[..., 0].astype(float)
    y, x = np.indices(crop.shape)
    middle = np.array([[(crop * x).sum() / crop.sum(), (crop * y).sum() / crop.sum()]])
    np.testing.assert_allclose(mapped(middle, roi.matrix(60))[0], (61.5, 41.5), atol=0.1)


@pytest.mark.parametrize("roi", [Roi(51.3, 40.2, 60.0, 0.1), Roi(5.0, 3.0, 40.0, -0.4), Roi(90.0, 70.0, 31.0, 3.0)])
def test_the_portable_warp_differs_by_a_rounding_only(roi: Roi) -> None:
    """Places of 1/32 px: half of one off, along and down, in a picture whose pixels change by at most that much."""
    y, x = np.mgrid[0:80, 0:100]
    image = np.stack([2 * x, 3 * y, x + y], axis=2).astype(np.uint8)
    exact, rounded = (roi.crop(image, roi.matrix(64), 64, cv2.BORDER_REPLICATE, way).astype(int) for way in (warp, portable_warp))
    assert np.abs(exact - rounded).max() <= 1 and rounded.std() > 5
