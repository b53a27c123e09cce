"""PSNR and SSIM as printed in papers on angular super-resolution: of luma in studio range, without a border."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

PEAK = 255.0
LUMA = np.array([65.481, 128.553, 24.966]) / 255  # ITU-R BT.601, 16 to 235, as MATLAB's rgb2ycbcr
BLACK = 16.0
SIGMA_PX, WINDOW_PX = 1.5, 11  # Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment", IEEE TIP 2004
K1, K2 = 0.01, 0.03
BEST_DB = 100.0  # for identical pictures


def studio_luma(planes: NDArray[np.generic]) -> Float:
    """Luma, float64 (h, w), 16 to 235, of planar RGB (3, h, w) or grey (1, h, w) with values 0 to 255. Not rounded."""
    weights = LUMA if len(planes) == 3 else LUMA.sum(keepdims=True)
    return np.asarray(np.tensordot(weights, np.asarray(planes, np.float64), 1) + BLACK, np.float64)


def shaved(picture: Float, border_px: int) -> Float:
    """The picture without border_px on each side. Raises ValueError if the rest is too small for SSIM."""
    height, width = picture.shape
    if min(height, width) - 2 * border_px < WINDOW_PX:
        raise ValueError(f"a view of {width}x{height} px is too small for a border of {border_px} px")
    return picture[border_px : height - border_px, border_px : width - border_px]


def psnr_db(a: Float, b: Float) -> float:
    """Peak signal-to-noise ratio in dB, peak 255; BEST_DB if a equals b."""
    square = float(np.mean(np.square(a - b)))
    return BEST_DB if square == 0 else min(BEST_DB, 10 * math.log10(PEAK**2 / square))


def ssim(a: Float, b: Float) -> float:
    """Mean structural similarity: Gaussian window of 11x11 with sigma 1.5, population covariance, peak 255.

    The mean is over the windows that lie within the picture, as in the authors' code and in scikit-image.
    """

    def mean(values: Float) -> Float:
        return cv2.GaussianBlur(values, (WINDOW_PX, WINDOW_PX), SIGMA_PX, borderType=cv2.BORDER_REFLECT)  # type: ignore[return-value]

    mean_a, mean_b = mean(a), mean(b)
    var_a, var_b, both = mean(a * a) - mean_a**2, mean(b * b) - mean_b**2, mean(a * b) - mean_a * mean_b
    c1, c2 = (K1 * PEAK) ** 2, (K2 * PEAK) ** 2
    found = (2 * mean_a * mean_b + c1) * (2 * both + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    pad = WINDOW_PX // 2
    return float(found[pad:-pad, pad:-pad].mean())
