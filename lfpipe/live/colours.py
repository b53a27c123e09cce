"""Colours of cameras in a row: those of each follow the camera to its left.

No two cameras expose and balance alike, nor have the same response. Of the points that two views
show, the values in both are sorted, and equal ranks correspond: neither inexact disparity nor noise
displaces ranks by much.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.live.records import UNCHANGED

RANKS_PERCENT = np.linspace(2, 98, 13)
# Of a frame in the levels: a drift is followed within 0.2 s; a step, of as many levels, at once.
SHARE, STEP_LEVELS = 0.3, 8.0


class Colours:
    """Follows the colours of a row of cameras, frame by frame."""

    def __init__(self, cols: int) -> None:
        self._levels = np.stack([UNCHANGED] * cols).astype(np.float64)

    @property
    def curves(self) -> NDArray[np.uint8]:
        """As in the record of disparity."""
        return np.clip(np.rint(self._levels), 0, 255).astype(np.uint8)

    def add(self, col: int, wanted: NDArray[np.uint8], found: NDArray[np.uint8]) -> None:
        """Adds a frame: the values (n, 3) that that camera has found at some points, and what is
        wanted, those of the camera to its left in its final colours.
        """
        ranks = (np.percentile(one[::4], RANKS_PERCENT, axis=0).T for one in (found, wanted))
        # black is black, and what is brighter than all is so by the gain of the brightest
        curves = [
            np.interp(UNCHANGED[:, 0], [0, *was, 255], [0, *to, to[-1] * 255 / max(was[-1], 1)])
            for was, to in zip(*ranks, strict=True)
        ]
        change = np.stack(curves, axis=1) - self._levels[col]
        self._levels[col] += change * np.clip(np.abs(change).mean() / STEP_LEVELS, SHARE, 1)


def matched(picture: NDArray[np.uint8], curve: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture, BGR, whose values are replaced by those of a curve."""
    if np.array_equal(curve, UNCHANGED):
        return picture
    return np.asarray(cv2.LUT(picture, curve[None]), np.uint8)
