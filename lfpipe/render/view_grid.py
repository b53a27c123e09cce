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
    """Render's report about the eyes. eyes_px, centre_px: in the camera picture. views: (row, col) of each eye. alpha_px: px per
    view."""

    rows: int
    cols: int
    alpha_px: float
    centre_px: tuple[float, float]
    eyes_px: tuple[tuple[float, float], tuple[float, float]]
    views: tuple[tuple[float, float], tuple[float, float]]
    face: bool

    @classmethod
    def of(cls, message: dict[str, Any]) -> EyesOnGrid:
        """From a message of topic "look"."""
        rows, cols = message["grid"]
        (lx, ly), (rx, ry) = message["eyes_px"]
        (lr, lc), (rr, rc) = message["views"]
        x, y = message["centre_px"]
        return cls(rows, cols, message["alpha_px"], (x, y), ((lx, ly), (rx, ry)), ((lr, lc), (rr, rc)), message["face"])

    def place_px(self, row: float, col: float) -> tuple[float, float]:
        """The position of an eye that sees the view: the inverse of `ViewSolver.views`."""
        x, y = self.centre_px
        return x - (col - (self.cols - 1) / 2) * self.alpha_px, y + (row - (self.rows - 1) / 2) * self.alpha_px


def _dot(picture: NDArray[np.uint8], x: float, y: float, radius: float, colour: tuple[int, int, int], filled: bool) -> None:
    at = round(x * (1 << _SHIFT)), round(y * (1 << _SHIFT))
    cv2.circle(picture, at, max(1, round(radius * (1 << _SHIFT))), colour, -1 if filled else 1, cv2.LINE_AA, _SHIFT)


def draw_over_eyes(picture: NDArray[np.uint8], seen: EyesOnGrid, scale: float = 1.0) -> None:
    """Draws into uint8 (height, width, 3) BGR, a camera picture scaled by `scale`: a dot per view, the left eye red, the right
    cyan."""
    if seen.alpha_px <= 0:
        return
    radius = min(max(seen.alpha_px * scale / 8, 0.8), 4.0)
    far = 4.0 * max(picture.shape)
    across = [scale * seen.place_px(0, col)[0] for col in range(seen.cols)]
    down = [scale * seen.place_px(row, 0)[1] for row in range(seen.rows)]
    dots = [[round(at * (1 << _SHIFT)) for at in line if abs(at) < far] for line in (across, down)]
    size = max(1, round(radius * (1 << _SHIFT)))
    for at in itertools.product(*dots):
        cv2.circle(picture, at, size, GRID_BGR, -1, cv2.LINE_AA, _SHIFT)
    for (x, y), colour, letter in zip(seen.eyes_px, (LEFT_BGR, RIGHT_BGR), "LR", strict=True):
        if seen.face and abs(x) * scale < far and abs(y) * scale < far:
            _dot(picture, x * scale, y * scale, max(6.0 * scale, 3 * radius), colour, False)
            _dot(picture, x * scale, y * scale, max(2.0 * scale, radius), colour, True)
            at = round(x * scale + max(8.0 * scale, 4 * radius)), round(y * scale)
            cv2.putText(picture, letter, at, cv2.FONT_HERSHEY_PLAIN, max(1.2 * scale, 0.8), colour, 1, cv2.LINE_AA)


def inset(seen: EyesOnGrid, side_px: int) -> NDArray[np.uint8]:
    """A small map of the grid with both eyes, uint8 (h, w, 3) BGR: white on black, readable through any glasses."""
    step = side_px / max(seen.rows, seen.cols, 2)
    picture = np.zeros((max(round(step * seen.rows), 2), max(round(step * seen.cols), 2), 3), np.uint8)
    for row in range(seen.rows):
        for col in range(seen.cols):
            _dot(picture, (col + 0.5) * step, (row + 0.5) * step, max(step / 10, 0.7), (150, 150, 150), True)
    for (at_row, at_col), filled, letter in zip(seen.views, (True, False), "LR", strict=True):
        if abs(at_row) < 1e4 and abs(at_col) < 1e4:
            x, y, radius = (at_col + 0.5) * step, (at_row + 0.5) * step, max(step / 3, 3.0)
            _dot(picture, x, y, radius, (255, 255, 255), filled)
            at = round(min(x + radius + 2, picture.shape[1] - 9)), round(min(max(y - radius, 9), picture.shape[0] - 1))
            cv2.putText(picture, letter, at, cv2.FONT_HERSHEY_PLAIN, 0.8, (255, 255, 255), 1, cv2.LINE_AA)
    return picture
