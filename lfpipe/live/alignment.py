"""Alignment of two cameras in a row: how the right one stands against the left one, and how their
lenses differ, from the vertical flow between their pictures.

In aligned views, flow is horizontal. To first order, a camera that is turned by r about its axis,
points by h lower, enlarges by 1 + e, turns to the side by a and down by d, and whose lens bends by
k, adds the vertical flow

    v(x, y) = h + r * x + y * (e + k * (x^2 + y^2) + a * x + d * y),

x, y and v from the middle of the picture, in halves of its width.
"""

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Placement
from lfpipe.scene.optical_flow import FloatMap, Grey, robust_fit, textured

SAMPLES = 800  # pixels of a frame that are compared
TOLERANCE_PX = 0.5  # of the fit: flow beyond it is wrong or of a moving thing
FAST_FRAMES = 20  # the mean of as many is taken at first
LATER_SHARE = 0.3  # of a frame afterwards
FIRM = np.eye(6)[3:]  # weighs k, a and d, of which a picture with little texture says nothing


class Alignment:
    """Follows the alignment, frame by frame."""

    def __init__(self, width_px: int, start: Placement | None = None) -> None:
        """start: as it was measured before."""
        self._half_px = width_px / 2
        self.bend = np.zeros(6)
        """h, r, e, k, a, d."""
        self.frames = 0
        """With enough texture."""
        if start is not None:
            turn = math.radians(start.rotation_deg)
            self.bend[:3] = start.height_px / self._half_px, turn, start.scale - 1
            self.frames = FAST_FRAMES

    def add(self, left: Grey, lower_px: FloatMap) -> None:
        """Adds a frame: the left view at half its size, and by how much its points lie lower in
        the aligned right one, in px of the full size.
        """
        at = np.flatnonzero(textured(left))
        if len(at) < SAMPLES // 8:
            return
        at = at[:: max(1, len(at) // SAMPLES)]
        row, col = np.divmod(at, left.shape[1])
        x, y = (2 * col + 1) / left.shape[1] - 1, (2 * row + 1 - left.shape[0]) / left.shape[1]
        matrix = np.column_stack([np.ones(len(at)), x, y, y * (x**2 + y**2), y * x, y * y])
        rest_px = robust_fit(
            np.vstack([matrix, FIRM]),
            np.append(lower_px.ravel()[at], np.zeros(len(FIRM))),
            TOLERANCE_PX,
        )
        self.frames += 1
        share = 1 / self.frames if self.frames <= FAST_FRAMES else LATER_SHARE
        # the flow was measured in a view that is aligned already
        self.bend += share * rest_px / self._half_px

    def placement(self, swapped: bool) -> Placement:
        """Of the right camera against the left one."""
        height, turn, larger = self.bend[:3].tolist()
        return Placement(
            height_px=height * self._half_px,
            rotation_deg=math.degrees(turn),
            scale=1 + larger,
            swapped=swapped,
        )


@lru_cache(maxsize=4)
def _places(height: int, width: int, bend: bytes) -> tuple[FloatMap, FloatMap]:
    """x and y in the delivered right view, float32 (height, width), of an aligned one's pixels."""
    low, turn, larger, lens, across, down = np.frombuffer(bend).tolist()
    half = width / 2
    x = ((np.arange(width) + 0.5) / half - 1).astype(np.float32)
    y = ((np.arange(height)[:, None] + 0.5 - height / 2) / half).astype(np.float32)
    zoom = half * ((1 + larger + lens * x**2 + across * x) + (lens * y**2 + down * y))
    x, y = zoom * x, zoom * y
    return (
        math.cos(turn) * x - math.sin(turn) * y + (half - 0.5),
        math.sin(turn) * x + math.cos(turn) * y + (height / 2 - 0.5 + low * half),
    )


def aligned(picture: NDArray[np.uint8], bend: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The right view of any size, aligned; the border is repeated. bend: that of `Alignment`."""
    if not bend.any():
        return picture
    places = _places(*picture.shape[:2], bend.tobytes())
    return np.asarray(
        cv2.remap(picture, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )
