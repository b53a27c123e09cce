"""Scaling of pictures, and arrangement of two views for 3-D screens in the screen's own pixels:
after scaling, so that rows are preserved.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.files.decoding import fit_area


def scale_into(picture: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Scales picture into out, which has equally many channels: cubic to enlarge (as fast as
    linear), by area to shrink; a copy if the sizes are equal.
    """
    way = cv2.INTER_AREA if out.size < picture.size else cv2.INTER_CUBIC
    cv2.resize(picture, (out.shape[1], out.shape[0]), dst=out, interpolation=way)


Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]


def arrange_stereo_pair(
    pair: Pair,
    how: str,
    screen_px: tuple[int, int],
    first_row: int = 0,
    out: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """The picture, uint8 (height, width, 3) BGR, of exactly screen_px (width, height); written to
    out if that has the size.

    pair: left and right view. how: "row-interleaved" (even rows of the screen to the left eye) or
    "side-by-side" (each view squeezed into its half, so that a 3-D screen that stretches the halves
    shows it in its own shape). first_row: the row of the screen on which the picture begins.
    """
    width, height = screen_px
    if out is None or out.shape != (height, width, 3):
        out = np.empty((height, width, 3), np.uint8)
    x, y, w, h = fit_area((pair[0].shape[1], pair[0].shape[0]), screen_px)
    if (w, h) != screen_px:
        out[:] = 0
    for eye, view in enumerate(pair):
        if how == "side-by-side":
            left, right = (eye * width + x) // 2, (eye * width + x + w) // 2
            if left < right:  # else the screen is too narrow for two
                scale_into(view, out[y : y + h, left:right])
            continue
        whole = np.empty((h, w, 3), np.uint8)
        scale_into(view, whole)
        row = (eye - first_row - y) % 2  # of the area: on the screen it is row first_row + y + row
        out[y + row : y + h : 2, x : x + w] = whole[row::2]
    return out
