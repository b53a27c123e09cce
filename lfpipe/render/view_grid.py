"""The grid of views over the viewer's eyes in the camera picture: the position of an eye for each stored view."""

from __future__ import annotations

import itertools
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

LEFT_BGR, RIGHT_BGR, GRID_BGR = (60, 60, 255), (255, 255, 60), (235, 235, 235)
_SHIFT = 4  # sub-pixel bits of OpenCV's drawing


@attrs.frozen
class EyesOnGrid:
    """Render's report about the eyes. eyes_px, centre_px: in the camera picture. alpha_px: px per view."""

    rows: int
    cols: int
    alpha_px: float
    centre_px: tuple[float, float]
    eyes_px: tuple[tuple[float, float], tuple[float, float]]
    face: bool

    @classmethod
    def of(cls, message: dict[str, Any]) -> EyesOnGrid:
        """From a message of topic "look"."""
        (rows, cols), centre_px, (left_px, right_px) = (
            message["grid"],
            tuple(message["centre_px"]),
            map(tuple, message["eyes_px"]),
        )
        return cls(rows, cols, message["alpha_px"], centre_px, (left_px, right_px), message["face"])

    def place_px(self, row: float, col: float) -> tuple[float, float]:
        """The position of an eye that sees the view: the inverse of `ViewSolver.views`."""
        x, y = self.centre_px
        return x - (col - (self.cols - 1) / 2) * self.alpha_px, y + (row - (self.rows - 1) / 2) * self.alpha_px


def draw_over_eyes(picture: NDArray[np.uint8], seen: EyesOnGrid, scale: float = 1.0) -> None:
    """Draws into uint8 (height, width, 3) BGR, a camera picture scaled by `scale`: a dot per view, the left eye red, the right
    cyan."""
    if seen.alpha_px <= 0:
        return
    radius, far = min(max(seen.alpha_px * scale / 8, 0.8), 4.0), 4.0 * max(picture.shape)

    def dot(x: float, y: float, radius: float, colour: tuple[int, int, int], thickness: int = -1) -> None:
        x, y, radius = (round(value * (1 << _SHIFT)) for value in (x, y, radius))
        cv2.circle(picture, (x, y), max(1, radius), colour, thickness, cv2.LINE_AA, _SHIFT)

    across = [scale * seen.place_px(0, col)[0] for col in range(seen.cols)]
    down = [scale * seen.place_px(row, 0)[1] for row in range(seen.rows)]
    for x, y in itertools.product(across, down):
        if abs(x) < far and abs(y) < far:
            dot(x, y, radius, GRID_BGR)
    for (x, y), colour, letter in zip(seen.eyes_px, (LEFT_BGR, RIGHT_BGR), "LR", strict=True):
        if seen.face and abs(x) * scale < far and abs(y) * scale < far:
            dot(x * scale, y * scale, max(6.0 * scale, 3 * radius), colour, 1)
            dot(x * scale, y * scale, max(2.0 * scale, radius), colour)
            at = round(x * scale + max(8.0 * scale, 4 * radius)), round(y * scale)
            cv2.putText(picture, letter, at, cv2.FONT_HERSHEY_PLAIN, max(1.2 * scale, 0.8), colour, 1, cv2.LINE_AA)
