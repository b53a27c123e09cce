"""The mean of several warped views, weighted block by block, and sharpened.

Sampling between pixels is bilinear, which blurs: not at all on a pixel, most halfway between two. At a fraction f, Keys' cubic
convolution differs from it, along each axis, by -f (1 - f) / 2 times the second difference of the plane (Keys, "Cubic convolution
interpolation for digital image processing", IEEE Trans. ASSP 29(6), 1981, with a = -1/2). That second difference is computed
once, of the mean instead of each view, with one f (1 - f) for the whole picture: two thirds of the gain of cubic sampling in a
fifteenth of its time (docs/quality.md).
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.blocks import size_of

SHARPEN = 0.5  # times f (1 - f) times the second difference
_EVERY = 8  # one block in this many, along either axis, is sampled for the fractions


class ViewMean:
    """Sums up to four planes of several views; owns its buffers, so a call allocates next to nothing."""

    def __init__(self, height_px: int, width_px: int) -> None:
        rows, cols = self._size = size_of(height_px, width_px)
        self._sums = np.zeros((4, rows, cols * 4), np.float32)
        self._total = np.zeros((rows, cols), np.float32)
        self._scale = np.empty((rows, cols, 4), np.float32)
        self._weights = np.empty((rows, cols, 4), np.uint8)
        self._whole, self._sharp = (np.empty((2 * rows, 2 * cols), np.float32) for _ in range(2))
        self._samples = math.ceil(rows / _EVERY) * math.ceil(cols / _EVERY)
        self._gain_x = self._gain_y = 0.0

    def clear(self, planes: int) -> None:
        """Starts a new picture of this many planes."""
        self._sums[:planes].fill(0)
        self._total.fill(0)
        self._gain_x = self._gain_y = 0.0

    def weigh(
        self, band: slice, weights: NDArray[np.uint8], share: float, x: NDArray[np.float32], y: NDArray[np.float32]
    ) -> None:
        """Announces the next band of a view: its weight at each block, uint8 (rows, columns), the view's share of the whole
        picture, and the places to be sampled in it."""
        cv2.merge([weights] * 4, self._weights[: len(weights)])
        cv2.accumulate(weights, self._total[band])
        first = -band.start % _EVERY
        share /= self._samples
        self._gain_x += share * _blur(x[first::_EVERY, ::_EVERY])
        self._gain_y += share * _blur(y[first::_EVERY, ::_EVERY])

    def add(self, number: int, band: slice, blocks: NDArray[np.uint8]) -> None:
        """Adds one plane of that band, as uint8 (rows, columns, 4) blocks."""
        total = self._sums[number][band]
        cv2.accumulateProduct(blocks.reshape(total.shape), self._weights[: len(blocks)].reshape(total.shape), total)

    def planes(self, outs: list[NDArray[np.uint8]]) -> None:
        """Writes the means of the planes so far to outs, uint8 (height, width) each."""
        np.reciprocal(self._total, out=self._total)  # cv2.divide takes 4x1 arrays for scalars
        cv2.merge([self._total] * 4, self._scale)
        scale = self._scale.reshape(self._sums[0].shape)
        across, down = (np.array([-g, 1 + 2 * g, -g], np.float32) for g in (SHARPEN * self._gain_x, SHARPEN * self._gain_y))
        lines = self._whole.view(np.float64)
        for total, out in zip(self._sums, outs, strict=False):
            cv2.multiply(total, scale, total)
            pairs = total.view(np.float64).reshape(*self._size, 2)
            cv2.extractChannel(pairs, 0, lines[0::2])
            cv2.extractChannel(pairs, 1, lines[1::2])
            height, width = out.shape
            inner = self._whole[:height, :width]
            sharp = self._sharp[:height, :width]
            cv2.sepFilter2D(inner, cv2.CV_32F, across, down, sharp, borderType=cv2.BORDER_REPLICATE)
            cv2.threshold(sharp, 0.0, 0.0, cv2.THRESH_TOZERO, sharp)  # the conversion takes absolute values
            cv2.convertScaleAbs(sharp, out)


def _blur(at: NDArray[np.float32]) -> float:
    """Sum of f (1 - f) over the fractions f of places: 0 on pixels, 0.25 each halfway between."""
    fraction = at - np.floor(at)
    return float((fraction - fraction * fraction).sum(dtype=np.float64))
