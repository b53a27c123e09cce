"""A picture scaled into a given area: its aspect kept, bars where it does not fill."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def fit_area(picture_px: tuple[int, int], area_px: tuple[int, int]) -> tuple[int, int, int, int]:
    """The largest (x, y, width, height) of the picture's aspect in the middle of the area; both sizes are (width, height)."""
    width, height = picture_px
    scale = min(area_px[0] / width, area_px[1] / height)
    fit_w = max(1, min(area_px[0], round(width * scale)))
    fit_h = max(1, min(area_px[1], round(height * scale)))
    return (area_px[0] - fit_w) // 2, (area_px[1] - fit_h) // 2, fit_w, fit_h


def scale_into(picture: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Writes picture into out, of as many channels: cubic where it grows (as fast as linear), by area where it shrinks."""
    if picture.shape == out.shape:
        np.copyto(out, picture)
        return
    shrinks = out.shape[0] < picture.shape[0]
    way = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    cv2.resize(picture, (out.shape[1], out.shape[0]), dst=out, interpolation=way)
