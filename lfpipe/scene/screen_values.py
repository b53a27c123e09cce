"""Converts a source's values to 8-bit screen values: bit depth, linear light, grey."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

STRIP_ROWS = 256  # processed at a time, to limit memory for large views
SCREEN_GAMMA = 2.2  # of linear-light pictures: out = in ** (1 / gamma)
_DARK = 0.17  # median and mean of a linear-light picture of an ordinary scene are lower, those of a screen-ready one higher


def screen_table(max_value: int, gamma: float) -> NDArray[np.uint8]:
    """uint8 by source value 0 .. max_value: 255 * (v / max_value) ** (1 / gamma), rounded."""
    values = np.arange(max_value + 1, dtype=np.float64) / max_value
    return np.asarray(np.rint(255 * values ** (1 / gamma)), np.uint8)


def to_screen(pixels: NDArray[Any], table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """pixels through the table; values beyond it count as full."""
    if pixels.dtype == np.uint8 and len(table) == 256:
        return np.asarray(table[pixels], np.uint8)
    return np.asarray(table[np.minimum(pixels, len(table) - 1)], np.uint8)


def is_grey(pixels: NDArray[Any]) -> bool:
    """Whether a picture has one plane or three equal ones."""
    if pixels.ndim == 2:
        return True
    strips = (pixels[top : top + STRIP_ROWS] for top in range(0, len(pixels), STRIP_ROWS))
    return all(np.array_equal(s[..., 0], s[..., 1]) and np.array_equal(s[..., 1], s[..., 2]) for s in strips)


def looks_linear(middle: NDArray[Any], max_value: int) -> bool:
    """Whether a middle view looks like undeveloped linear light of a plenoptic camera: dark, and black rounded corners.

    Darkness alone would also catch scenes lit by a lamp; the black corners are what rectification leaves.
    """
    step = max(1, min(middle.shape[:2]) // 1024)  # a sample of pixels suffices for a large view
    middle = middle[::step, ::step]
    grey = (middle if middle.ndim == 2 else middle.mean(axis=2)) / max_value
    side = max(2, min(grey.shape) // 64)
    corners = [grey[:side, :side], grey[:side, -side:], grey[-side:, :side], grey[-side:, -side:]]
    black = sum(float(corner.max()) < 0.01 for corner in corners)
    empty = float(np.mean(grey < 0.01))  # a black background is not a vignette
    return bool(float(np.median(grey)) < _DARK and float(grey.mean()) < 0.2 and black >= 2 and empty < 0.15)
