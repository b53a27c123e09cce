"""The square, turned piece of the picture that a network looks at: region of interest and crop.

Proportions follow the face graphs that the networks were trained for (MediaPipe, modules/face_landmark).
"""

from __future__ import annotations

import math

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

SCALE = 1.5  # the region over the face, so that the face of the next picture is still inside


@attrs.frozen
class Roi:
    """A square in picture px: centre, side, and angle of its x axis (radians, clockwise as y points down)."""

    x_px: float
    y_px: float
    side_px: float
    angle: float

    def matrix(self, size_px: int) -> NDArray[np.float64]:
        """Affine (2, 3) from crop px (0..size_px) to picture px."""
        scale = self.side_px / size_px
        c, s = math.cos(self.angle) * scale, math.sin(self.angle) * scale
        half = size_px / 2
        return np.array([[c, -s, self.x_px - half * (c - s)], [s, c, self.y_px - half * (s + c)]])

    def crop(self, image: NDArray[np.uint8], size_px: int, border: int) -> NDArray[np.uint8]:
        """The region as uint8 BGRA (size_px, size_px, 4). border: cv2.BORDER_*, what lies outside of the picture.

        Four channels are warped in 0.4 of the time of three, to the same values.
        """
        matrix = self.matrix(size_px)
        reach = 0.75 * self.side_px + 2  # half of the diagonal, and what interpolation looks at
        height, width = image.shape[:2]
        x0, x1 = (min(max(int(self.x_px + d), 0), width) for d in (-reach, reach))
        y0, y1 = (min(max(int(self.y_px + d), 0), height) for d in (-reach, reach))
        if x1 - x0 < 1 or y1 - y0 < 1:
            x0, y0, x1, y1 = 0, 0, width, height
        part = cv2.cvtColor(image[y0:y1, x0:x1], cv2.COLOR_BGR2BGRA)
        matrix[:, 2] -= x0, y0
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(part, matrix, (size_px, size_px), flags=flags, borderMode=border), np.uint8)

    def to_picture(self, points: NDArray[np.floating], size_px: int) -> NDArray[np.float64]:
        """points (n, 2) in crop px -> picture px."""
        moved = cv2.transform(np.asarray(points, np.float64)[:, None], self.matrix(size_px))
        return np.asarray(moved[:, 0], np.float64)


def around(
    box_px: tuple[float, float, float, float], start: NDArray[np.floating], end: NDArray[np.floating], scale: float = SCALE
) -> Roi:
    """Region around an upright box (x0, y0, x1, y1), turned so that start -> end (eye to eye) lies along its x axis."""
    x0, y0, x1, y1 = box_px
    angle = math.atan2(float(end[1] - start[1]), float(end[0] - start[0]))
    return Roi((x0 + x1) / 2, (y0 + y1) / 2, max(x1 - x0, y1 - y0) * scale, angle)


def as_tensor(crop: NDArray[np.uint8], low: float, high: float) -> NDArray[np.float32]:
    """uint8 BGRA crop -> float32 (1, h, w, 3) RGB, 0..255 mapped to low..high."""
    rgb = cv2.cvtColor(crop, cv2.COLOR_BGRA2RGB)
    scaled = np.multiply(rgb, np.float32((high - low) / 255), dtype=np.float32)
    return (scaled + np.float32(low) if low else scaled)[None]
