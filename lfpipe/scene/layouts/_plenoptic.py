"""Common properties of plenoptic cameras: raw pictures are a honeycomb of lenslets, the outer views are dark or empty."""

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.source import ViewIndex

_CROP_PX, _PITCH_PX, _PEAK = 512, (5, 30), 300.0  # of the examined part, of a lenslet; over the median around it
_SMALLEST_PX = 256  # side of a raw picture: at least thousands of px
_DARK_SIDE, _DARK_VIEW = 0.55, 0.4  # brightness over that of the middle view; darker sides and views are left out


def is_honeycomb(picture: NDArray[Any]) -> bool:
    """Whether a picture is a raw honeycomb of lenslets: its spectrum has peaks at equal distance, 60 degrees apart."""
    plane = picture if picture.ndim == 2 else picture[..., 1]
    size = min(_CROP_PX, *plane.shape)
    top, left = ((side - size) // 2 for side in plane.shape)
    if size < _SMALLEST_PX:
        return False
    window = np.hanning(size).astype(np.float32)
    part = plane[top : top + size, left : left + size].astype(np.float32)
    if part.std() < 1e-3 * (float(part.max()) + 1):
        return False
    power = np.fft.fftshift(np.abs(np.fft.fft2((part - part.mean()) * window * window[:, None])) ** 2)
    y, x = np.mgrid[:size, :size] - size // 2
    away = np.hypot(x, y)
    ring = (away > size / _PITCH_PX[1]) & (away < size / _PITCH_PX[0])
    at = int(np.argmax(np.where(ring, power, 0)))
    peak_y, peak_x = (int(v) - size // 2 for v in divmod(at, size))
    radius = float(np.hypot(peak_x, peak_y))
    usual = float(np.median(power[np.abs(away - radius) < 0.2 * radius]))
    for angle in (np.pi / 3, -np.pi / 3):
        px = round(peak_x * np.cos(angle) - peak_y * np.sin(angle)) + size // 2
        py = round(peak_x * np.sin(angle) + peak_y * np.cos(angle)) + size // 2
        near = power[max(0, py - 2) : py + 3, max(0, px - 2) : px + 3]
        if not near.size or float(near.max()) < max(_PEAK * usual, 0.05 * float(power.flat[at])):
            return False
    return True


@attrs.frozen
class BrightPart:
    """The lit views of a plenoptic camera. top, left: of the first one; missing: dark places within the part."""

    top: int
    left: int
    rows: int
    cols: int
    missing: set[ViewIndex]


def bright_part(read: Callable[[int, int], NDArray[Any] | None], rows: int, cols: int) -> BrightPart:
    """Removes whole sides, evenly from both ends, while the middle of a side is dark; dark views in the corners count as missing.
    read(row, col): a view, or None.
    """

    def light(row: int, col: int) -> float:
        view = read(row, col)
        return 0.0 if view is None else float(view[::4, ::4].mean())

    middle = light(rows // 2, cols // 2)
    top = left = 0
    while rows - 2 * top > 2 and min(light(top, cols // 2), light(rows - 1 - top, cols // 2)) < _DARK_SIDE * middle:
        top += 1
    while cols - 2 * left > 2 and min(light(rows // 2, left), light(rows // 2, cols - 1 - left)) < _DARK_SIDE * middle:
        left += 1
    inner_rows, inner_cols = rows - 2 * top, cols - 2 * left
    missing: set[ViewIndex] = set()
    for row in range(inner_rows):
        for col in range(inner_cols):
            # light falls off only towards the corners: no need to check the rest of the grid
            corner = min(row, inner_rows - 1 - row) + min(col, inner_cols - 1 - col) < max(1, min(inner_rows, inner_cols) // 4)
            if corner and light(row + top, col + left) < _DARK_VIEW * middle:
                missing.add((row, col))
    return BrightPart(top, left, inner_rows, inner_cols, missing)
