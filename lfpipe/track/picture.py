"""Converts pictures of any common depth and channel count for the engines."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError


def as_bgr8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """image as uint8 (height, width, 3) BGR, without a copy if it already is.

    Accepts uint8 or uint16 (scaled by 1/256), grey (h, w) or (h, w, 1), BGR, BGRA. Raises UserError for anything else.
    """
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    shape = image.shape
    channels = shape[2] if len(shape) == 3 else 1
    if image.dtype != np.uint8 or len(shape) not in (2, 3) or channels not in (1, 3, 4) or 0 in shape:
        raise UserError(
            f"picture of shape {shape} and type {image.dtype}: cannot be searched for a face",
            "give 8 or 16 bit pictures, grey, BGR or BGRA, of at least one pixel",
        )
    if channels == 3:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR if channels == 1 else cv2.COLOR_BGRA2BGR), np.uint8)
