"""Scales a picture into an area: keeps the aspect and adds bars."""

import cv2
import numpy as np
from numpy.typing import NDArray


def scale_into(picture: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Scales picture into out, which has equally many channels: cubic to enlarge (as fast as linear), by area to shrink."""
    if picture.shape == out.shape:
        np.copyto(out, picture)
        return
    shrinks = out.shape[0] < picture.shape[0]
    way = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    cv2.resize(picture, (out.shape[1], out.shape[0]), dst=out, interpolation=way)
