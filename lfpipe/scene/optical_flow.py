"""Dense optical flow between two pictures, and where it can be relied on.

Dense inverse search (DIS): Kroeger, Timofte, Dai, Van Gool, "Fast Optical Flow using Dense Inverse Search", ECCV 2016, as
implemented in OpenCV.
"""

import threading

import cv2
import numpy as np
from numpy.typing import NDArray

FloatMap = NDArray[np.float32]
Grey = NDArray[np.uint8]
Mask = NDArray[np.bool_]

SMALLEST_PX = 24  # the flow needs a few of its 8x8 patches per side
# Of fine flow: scale, patch, stride of patches, steps of descent, smoothing. profiling/results/disparity.md
_FINEST_SCALE, _PATCH_PX, _PATCH_STRIDE_PX, _DESCENTS, _SMOOTHINGS = 0, 4, 3, 3, 2
_RETURN_PX, _RETURN_SHARE = 0.5, 0.1  # tolerance of flow followed back: px, and share of the way
_here = threading.local()  # flow objects own buffers, so each serves one thread


def flow(a: Grey, b: Grey, fine: bool = False) -> FloatMap:
    """Dense flow from a to b, float32 (h, w, 2) in px (x, y): the point at x in a is at x + flow in b.

    fine: down to single pixels, takes twice as long.
    """
    engines: dict[bool, cv2.DISOpticalFlow] = _here.__dict__.setdefault("engines", {})
    if fine not in engines:
        engine = engines[fine] = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        if fine:
            engine.setFinestScale(_FINEST_SCALE)
            engine.setPatchSize(_PATCH_PX)
            engine.setPatchStride(_PATCH_STRIDE_PX)
            engine.setGradientDescentIterations(_DESCENTS)
            engine.setVariationalRefinementIterations(_SMOOTHINGS)
    return np.asarray(engines[fine].calc(a, b, np.zeros((*a.shape, 2), np.float32)), np.float32)


def grid_xy(height: int, width: int) -> tuple[FloatMap, FloatMap]:
    """x and y of every pixel, float32 (h, w) each; cached per thread, read-only."""
    if getattr(_here, "size", None) != (height, width):
        yy, xx = np.mgrid[:height, :width].astype(np.float32)
        _here.size, _here.grid = (height, width), (xx, yy)
    grid: tuple[FloatMap, FloatMap] = _here.grid
    return grid


def confirmed(there: FloatMap, back: FloatMap) -> Mask:
    """The pixels whose flow to another view, followed back, returns to its start. float32 (h, w, 2) each."""
    xx, yy = grid_xy(*there.shape[:2])
    returned = cv2.remap(back, xx + there[..., 0], yy + there[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
                         borderValue=(1e4, 1e4, 0, 0))  # fmt: skip
    off = np.hypot(there[..., 0] + returned[..., 0], there[..., 1] + returned[..., 1])
    return np.asarray(off < _RETURN_PX + _RETURN_SHARE * np.hypot(there[..., 0], there[..., 1]), bool)


def returned_flow(a: Grey, b: Grey) -> tuple[FloatMap, Mask]:
    """The flow from a to b, and the pixels where the flow back confirms it."""
    ahead = flow(a, b)
    return ahead, confirmed(ahead, flow(b, a))


def textured(picture: Grey) -> Mask:
    """The fifth of the pixels with the strongest edges, unless they are too weak."""
    edges = np.abs(cv2.Sobel(picture, cv2.CV_32F, 1, 0)) + np.abs(cv2.Sobel(picture, cv2.CV_32F, 0, 1))
    return np.asarray(edges > max(40.0, float(np.percentile(edges, 80))), bool)
