"""The grid of views over the viewer's eyes in the camera picture: the position of an eye for each stored view."""

import itertools
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

LEFT_BGR, RIGHT_BGR, GRID_BGR = (60, 60, 255), (255, 255, 60), (235, 235, 235)
_SHIFT = 4  # sub-pixel bits of OpenCV's drawing


def place_px(look: Mapping[str, Any], row: float, col: float) -> tuple[float, float]:
    """The position of an eye that sees the view, in px of the camera picture: the inverse of `ViewSolver.views`. look: render's
    message of that topic."""
    (rows, cols), (x, y), alpha_px = look["grid"], look["centre_px"], look["alpha_px"]
    return x - (col - (cols - 1) / 2) * alpha_px, y + (row - (rows - 1) / 2) * alpha_px


def draw_over_eyes(picture: NDArray[np.uint8], look: Mapping[str, Any], scale: float = 1.0) -> None:
    """Draws into uint8 (height, width, 3) BGR, a camera picture scaled by `scale`: a dot per view, the left eye red, the right
    cyan. look: render's message of that topic."""
    (rows, cols), alpha_px = look["grid"], look["alpha_px"]
    if not alpha_px:  # nobody was seen yet
        return
    radius, far = min(max(alpha_px * scale / 8, 0.8), 4.0), 4.0 * max(picture.shape)

    def dot(x: float, y: float, radius: float, colour: tuple[int, int, int], thickness: int = -1) -> None:
        if abs(x) < far and abs(y) < far:
            x, y, radius = (round(value * (1 << _SHIFT)) for value in (x, y, radius))
            cv2.circle(picture, (x, y), max(1, radius), colour, thickness, cv2.LINE_AA, _SHIFT)

    for row, col in itertools.product(range(rows), range(cols)):
        x, y = place_px(look, row, col)
        dot(x * scale, y * scale, radius, GRID_BGR)
    for (x, y), colour in zip(look["eyes_px"], (LEFT_BGR, RIGHT_BGR), strict=True):
        if look["face"]:
            dot(x * scale, y * scale, max(6.0 * scale, 3 * radius), colour, 1)
            dot(x * scale, y * scale, max(2.0 * scale, radius), colour)
