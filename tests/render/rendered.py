"""A small light field drawn from formulas, so that every depth and every view, also between the stored ones, is known.

A textured wall at disparity FAR and before it a textured square at NEAR (px per grid step), on a grid of any size.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.lightfield import Geometry, LightField

FAR, NEAR = -1.0, 2.0
SQUARE = (20.0, 44.0)  # where the square begins and ends in the middle view, both axes, in px of a 64x64 view


def _texture(x: NDArray[np.float64], y: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    value = np.zeros_like(x)
    for _ in range(12):
        fx, fy, phase = rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(0, 6.28)
        value += np.sin(fx * x + fy * y + phase)
    return value / 12


def view(row: float, col: float, height: int = 64, width: int = 64, texture: float = 1.0) -> NDArray[np.uint8]:
    """The true view at steps (row, col) from the middle of the grid: uint8 (3, height, width), red, green, blue.

    texture: 0 leaves a plain bright square before a plain dark wall.
    """
    y, x = np.mgrid[0:height, 0:width].astype(float)
    planes = []
    inside = _square(row, col, height, width)
    for channel in range(3):
        wall = (110 if texture else 20) + 60 * texture * _texture(x + FAR * col, y + FAR * row, channel)
        square = (150 if texture else 240) + 80 * texture * _texture(x + NEAR * col, y + NEAR * row, 10 + channel)
        planes.append(np.where(inside, square, wall))
    return np.rint(np.stack(planes)).clip(0, 255).astype(np.uint8)


def _square(row: float, col: float, height: int, width: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[0:height, 0:width].astype(float)
    x, y = x + NEAR * col, y + NEAR * row
    low, high = SQUARE
    return (x >= low) & (x < high) & (y >= low) & (y < high)


def field(
    rows: int = 5,
    cols: int = 5,
    height: int = 64,
    width: int = 64,
    depth: bool = True,
    scale: float = 1.0,
    method: str = "warp2",
    texture: float = 1.0,
) -> LightField:
    """The grid as a LightField. scale: multiplies the grid's spacing, and so its disparities."""
    views = np.zeros((1, rows, cols, 3, height, width), np.uint8)
    low = ((height + 1) // 2, (width + 1) // 2)
    disparity = np.zeros((1, rows, cols, *low), np.int8)
    unit_px = max(abs(FAR), abs(NEAR)) * scale / 120
    for r in range(rows):
        for c in range(cols):
            row, col = (r - (rows - 1) / 2) * scale, (c - (cols - 1) / 2) * scale
            views[0, r, c] = view(row, col, height, width, texture)
            depth_px = np.where(_square(row, col, height, width), NEAR, FAR).astype(np.float32) * np.float32(scale / unit_px)
            disparity[0, r, c] = np.rint(cv2.resize(depth_px, low[::-1], interpolation=cv2.INTER_AREA))
    return LightField(
        views=views,
        disparity=disparity if depth else None,
        disparity_scale_px=unit_px,
        disparity_min_px=FAR * scale,
        disparity_max_px=NEAR * scale,
        disparity_source="truth" if depth else "none",
        offsets=np.zeros((rows, cols, 2), np.float32),
        present=np.ones((rows, cols), bool),
        geometry=Geometry(),
        frame_rate_hz=0.0,
        name="drawn",
        method=method if depth else "blend",
        manifest={},
    )


def noise(rows: int, cols: int, height: int, width: int, extent_px: float, seed: int, channels: int = 3) -> LightField:
    """Views and disparities of pure noise, up to +-extent_px, without any consistency."""
    rng = np.random.default_rng(seed)
    low = ((height + 1) // 2, (width + 1) // 2)
    return LightField(
        views=rng.integers(0, 256, (2, rows, cols, channels, height, width), dtype=np.uint8),
        disparity=rng.integers(-127, 128, (1, rows, cols, *low), dtype=np.int8),
        disparity_scale_px=extent_px / 127,
        disparity_min_px=-extent_px,
        disparity_max_px=extent_px,
        disparity_source="estimated",
        offsets=np.zeros((rows, cols, 2), np.float32),
        present=np.ones((rows, cols), bool),
        geometry=Geometry(),
        frame_rate_hz=25.0,
        name="noise",
        method="warp",
        manifest={},
    )
