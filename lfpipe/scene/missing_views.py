"""What stands for missing views: the nearest present one, or one view warped to the place of
another by its disparity, with holes filled from behind.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.optical_flow import FloatMap, displaced

_HIDDEN_PX = 1.0  # parallax that separates a surface from the one behind it


def nearest_present(present: NDArray[np.bool_], row: int, col: int) -> tuple[int, int]:
    """The present view closest to (row, col); among equals, the first in order."""
    rows, cols = np.nonzero(present)
    best = int(np.argmin((rows - row) ** 2 + (cols - col) ** 2))
    return int(rows[best]), int(cols[best])


def warped_disparity(disparity: FloatMap, down: float, across: float) -> FloatMap:
    """The disparity map of a view, warped to the view `down` rows and `across` columns further;
    float32 (h, w) both.

    If several surfaces land on a pixel, the nearest one is kept; pixels without any are filled from
    the farther neighbour.
    """
    height, width = disparity.shape
    order = np.argsort(disparity.ravel(), kind="stable")
    y, x = np.divmod(order, width)
    d = disparity.ravel()[order]
    to_x, to_y = np.rint(x - d * across).astype(np.intp), np.rint(y - d * down).astype(np.intp)
    inside = (to_x >= 0) & (to_x < width) & (to_y >= 0) & (to_y < height)
    out = np.full((height, width), np.inf, np.float32)
    if not inside.any():
        return disparity
    out[to_y[inside], to_x[inside]] = d[inside]
    cracks = np.asarray(
        cv2.medianBlur(np.where(np.isinf(out), np.float32(disparity.min()), out), 3), np.float32
    )
    for _ in range(height + width):
        empty = np.isinf(out)
        if not empty.any():
            break
        # the default border is the largest float, which is finite and would spread inwards
        out = np.where(
            empty, cv2.erode(out, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE), out
        )
    return np.maximum(out, cracks)


def nearest(usable: NDArray[np.bool_]) -> NDArray[np.intp]:
    """The flat index of the nearest usable pixel, by pixel (h, w)."""
    _, labels = cv2.distanceTransformWithLabels(
        (~usable).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    index = np.zeros(int(labels.max()) + 1, np.intp)
    index[labels[usable]] = np.flatnonzero(usable)
    return np.asarray(index[labels])


def warped_view(
    picture: NDArray[Any], disparity: FloatMap, target: FloatMap, down: float, across: float
) -> NDArray[Any]:
    """A view warped to the one `down` rows and `across` columns further, (h, w) or (h, w, 3).
    target: `warped_disparity` of disparity.

    If the source of a pixel shows a nearer surface, the pixel was hidden: the nearest pixel at its
    depth fills it.
    """
    by_px = np.dstack((target * np.float32(across), target * np.float32(down)))
    out = displaced(picture, by_px)
    step = max(abs(down), abs(across))
    hidden = (displaced(disparity, by_px) - target) * step > _HIDDEN_PX
    if not hidden.any():
        return out
    hidden = cv2.dilate(hidden.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    reach = 2 * int(step * float(np.ptp(disparity))) + 3
    behind = target - cv2.erode(
        target, np.ones((reach, reach), np.uint8), borderType=cv2.BORDER_REPLICATE
    ) < max(_HIDDEN_PX / max(step, 1e-9), 1e-6)
    usable = behind & ~hidden
    if not usable.any():
        return out
    flat = out.reshape(out.shape[0] * out.shape[1], -1).copy()
    flat[hidden.ravel()] = flat[nearest(usable)[hidden]]
    return flat.reshape(out.shape)
