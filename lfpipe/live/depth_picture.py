"""Disparity of a frame that holds a picture beside its depth, in grey or as hue, by the rules of
the layout rgbd of stills.

Both eyes' views are drawn from the picture, which is taken from the middle of the grid.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.live.estimator import RANGE_PERCENT, STEPS_PX, Found
from lfpipe.live.records import eye_views, map_size
from lfpipe.scene.disparity import quantised
from lfpipe.scene.layouts.rgbd import COLOURED, DISPARITY, colour_levels, filled
from lfpipe.scene.optical_flow import FloatMap

# Disparity between the ends of the grid, as a share of a view's width: that of a still, whose grid
# has eight steps.
SPAN = 8 * DISPARITY
MIDDLE = ((0.0, 0.5), (0.0, 0.5))  # (row, col) that both eyes' views are drawn for
# Hue of 256: depth rises from red, and noise around red lies on the other side of WRAP. Depth is
# pure colour; what is dark was not measured.
WRAP, DARK, PURE, PURE_SHARE = 245, 64, 200, 0.9
RANGE_SHARE = 0.02  # of a frame in the range of depth: it follows within seconds at 30 Hz


class DepthPicture:
    """Reads depth, frame by frame. Which half it is, and how it is coloured, is decided anew by
    each frame that shows it.
    """

    def __init__(self, live: LiveSource) -> None:
        self._live = live
        self.swapped = False
        """Whether depth is the first half, as in the record of disparity."""
        self.unclear_frames = 0
        """Before the first one that shows which half is depth. In them, it is the second, in
        grey.
        """
        self._known = False
        self._is_hue = False
        self._range: NDArray[np.float64] | None = None

    def read(self, frame: NDArray[np.uint8], inverted: bool) -> Found:
        """The disparity of a frame, uint8 (height, width, 3) BGR. inverted: dark is near."""
        live = self._live
        axis = 1 if live.tiles_across == 2 else 0
        halves = np.split(frame, 2, axis)
        self._tell_apart(halves)
        size_px = map_size(live)[::-1]
        # nearest: between two values of depth, there is none
        small = cv2.resize(halves[not self.swapped], size_px, interpolation=cv2.INTER_NEAREST)
        depth = np.asarray(small, np.uint8)
        near = _of_hue(depth) if self._is_hue else depth[..., 1].astype(np.float32)
        if inverted:
            near = -near
        share = filled(near, *self._follow_range(near))
        disparity = (share - np.float32(0.5)) * np.float32(SPAN * live.width_px)
        most_px = float(np.abs(disparity).max())
        step_px = next((step for step in STEPS_PX if most_px <= 127 * step), STEPS_PX[-1])
        maps = dict.fromkeys(eye_views(live), quantised(disparity, step_px))
        return Found.of(maps, step_px, np.array(MIDDLE))

    def _tell_apart(self, halves: list[NDArray[np.uint8]]) -> None:
        """The grey half beside a coloured one is depth, else the one of pure colours. Grey is less
        grey than in a still, because video rounds its colours.
        """
        less, more = sorted(colour_levels(half) for half in halves)
        pure = [_is_pure(half) for half in halves]
        hue = pure[0] != pure[1]
        if hue or (less < COLOURED < more and less < more / 2):
            self.swapped = pure[0] if hue else colour_levels(halves[0]) == less
            self._is_hue = hue
            self._known = True
        self.unclear_frames += not self._known

    def _follow_range(self, near: FloatMap) -> tuple[float, float]:
        """The farthest and the nearest depth: one flicker of it moves nothing."""
        known = near[np.isfinite(near)]
        if len(known):
            now = np.percentile(known, RANGE_PERCENT)
            was = now if self._range is None else self._range
            self._range = np.asarray(was + RANGE_SHARE * (now - was), np.float64)
        low, high = (0.0, 1.0) if self._range is None else self._range.tolist()
        return low, max(high, low + 1.0)


def _is_pure(half: NDArray[np.uint8]) -> bool:
    """Whether a picture is of pure colours and black, as depth is that is stored as hue."""
    small = cv2.resize(half, (64, 64), interpolation=cv2.INTER_NEAREST)
    _, saturation, value = cv2.split(cv2.cvtColor(small, cv2.COLOR_BGR2HSV_FULL))
    bright = value > DARK
    pure = bright & (saturation > PURE)
    return bool(bright.any() and pure.sum() > PURE_SHARE * bright.sum())


def _of_hue(depth: NDArray[np.uint8]) -> FloatMap:
    """Nearness in a picture whose hue is distance; NaN where it is dark."""
    hue, _, value = cv2.split(cv2.cvtColor(depth, cv2.COLOR_BGR2HSV_FULL))
    distance = np.where(hue >= WRAP, 0, hue).astype(np.float32)
    return np.where(value > DARK, -distance, np.float32(np.nan))
