"""Alignment of two cameras in a row: rotation, scale and height of the right one against the left
one, from the vertical flow between their pictures.

In aligned views, flow is horizontal. To first order, a camera that is turned by r about its axis,
enlarges by 1 + e and points by h px lower adds the vertical flow

    v(x, y) = h + r * x + e * y,        x, y from the middle of the picture.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Placement
from lfpipe.scene.optical_flow import FloatMap, Grey, robust_fit, textured

SAMPLES = 800  # pixels of a frame that are compared
TOLERANCE_PX = 0.5  # of the fit: flow beyond it is wrong or of a moving thing
FAST_FRAMES = 60  # the mean of as many is taken at first; then it follows slowly
SLOW = 0.04  # share of a later one


class Alignment:
    """Follows the alignment, frame by frame."""

    def __init__(self, width_px: int, height_px: int, start: Placement | None = None) -> None:
        """start: as it was measured before."""
        self._middle = (width_px - 1) / 2, (height_px - 1) / 2
        self._fit = np.zeros(3)  # height px, rotation rad, scale - 1
        self.frames = 0
        """With enough texture."""
        if start is not None:
            turn = math.radians(start.rotation_deg)
            self._fit = np.array([start.height_px, turn, start.scale - 1])
            self.frames = FAST_FRAMES
        self._applied = self._fit.copy()

    def add(self, left: Grey, flow_px: FloatMap) -> None:
        """Adds a frame: the left view at half its size, and the flow to the aligned right one, in
        px of the full size.
        """
        at = np.flatnonzero(textured(left))
        if len(at) < SAMPLES // 8:
            return
        at = at[:: max(1, len(at) // SAMPLES)]
        y, x = np.divmod(at, left.shape[1])
        matrix = np.column_stack(
            [np.ones(len(at)), 2.0 * x - self._middle[0], 2.0 * y - self._middle[1]]
        )
        rest = robust_fit(matrix, flow_px[..., 1].ravel()[at].astype(float), TOLERANCE_PX)
        self.frames += 1
        share = max(1 / self.frames, 1 / FAST_FRAMES if self.frames <= FAST_FRAMES else SLOW)
        # the flow was measured with what is applied already
        self._fit += share * (self._applied + rest - self._fit)
        self._applied = self._fit.copy()

    def placement(self, swapped: bool) -> Placement:
        """Of the right camera against the left one."""
        height_px, turn, larger = self._applied.tolist()
        return Placement(
            height_px=height_px,
            rotation_deg=math.degrees(turn),
            scale=1 + larger,
            swapped=swapped,
        )

    @property
    def matrix(self) -> NDArray[np.float32]:
        """From a pixel of the aligned right view to one of the delivered one: float32 (2, 3)."""
        height, turn, scale = self._applied.tolist()
        x, y = self._middle
        linear = np.array([[1 + scale, -turn], [turn, 1 + scale]])
        offset = np.array([x, y + height]) - linear @ (x, y)
        return np.column_stack([linear, offset]).astype(np.float32)


def aligned(
    picture: NDArray[np.uint8], matrix: NDArray[np.float32], size: float = 1.0
) -> NDArray[np.uint8]:
    """A picture at `size` of its size, sampled by a matrix of `Alignment`; the border is
    repeated.
    """
    if np.array_equal(matrix, np.eye(2, 3)):
        return picture
    scaled = matrix.copy()
    # pixel centres: x of the small picture is (x + 0.5) / size - 0.5 of the full one
    scaled[:, 2] = (matrix[:, 2] + (matrix[:, :2].sum(axis=1) - 1) * (0.5 / size - 0.5)) * size
    return np.asarray(
        cv2.warpAffine(
            picture,
            scaled,
            picture.shape[1::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        np.uint8,
    )
