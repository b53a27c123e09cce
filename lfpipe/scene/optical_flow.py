"""Dense optical flow between two pictures, its reliability, and views prepared for it.

Dense inverse search (DIS): Kroeger, Timofte, Dai, Van Gool, "Fast Optical Flow using Dense Inverse
Search", ECCV 2016, as implemented in OpenCV.
"""

import math
import threading
from collections.abc import Callable
from functools import lru_cache
from itertools import groupby
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.source import SceneSource, ViewIndex

FloatMap = NDArray[np.float32]
Grey = NDArray[np.uint8]
Mask = NDArray[np.bool_]

SMALLEST_PX = 24  # the flow needs a few of its 8x8 patches per side
# Of fine flow, down to scale 0. Chosen on 23 scenes, of 1 to 90 px between views:
# profiling/results/disparity.md
_PATCH_PX = 4
_PATCH_STRIDE_PX = 3
_SMOOTHINGS = 2
_DESCENTS = 8  # steps that a patch needs from a distant start
_DESCENTS_NEAR = 3  # steps that it needs from a start that is nearly right
RETURN_PX, _RETURN_SHARE = 0.5, 0.1  # tolerance of flow followed back: px, and share of the way
_FIT_ROUNDS = 6  # of a robust fit: weights hardly change afterwards
LUMA = (0.299, 0.587, 0.114)  # BT.601, as in OpenCV
LOOK_PX = 1 << 17  # pixels of a view, enough to determine order and fit
_DARK = 0.2  # views with a lower mean are brightened
_here = threading.local()  # flow engines of each thread


def flow(a: Grey, b: Grey) -> FloatMap:
    """Dense flow from a to b, float32 (h, w, 2) in px (x, y): the point at x in a is at x + flow in
    b.
    """
    return _calculated(_engine(fine=False), a, b, None)


def fine_flow(a: Grey, b: Grey, start: FloatMap | None = None) -> FloatMap:
    """`flow` down to single pixels, in twice the time.

    start: a guess, float32 (h, w, 2), overwritten. Each patch starts from the guess or from the
    result of the next coarser scale, whichever matches better.
    """
    engine = _engine(fine=True)
    engine.setGradientDescentIterations(_DESCENTS if start is None else _DESCENTS_NEAR)
    return _calculated(engine, a, b, start)


def _engine(fine: bool) -> cv2.DISOpticalFlow:
    """This thread's engine; engines have buffers of their own."""
    engines: dict[bool, cv2.DISOpticalFlow] = _here.__dict__.setdefault("engines", {})
    if fine not in engines:
        engine = engines[fine] = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        if fine:
            engine.setPatchSize(_PATCH_PX)
            engine.setPatchStride(_PATCH_STRIDE_PX)
            engine.setVariationalRefinementIterations(_SMOOTHINGS)
    # 1, a halved picture, is that of the preset, but a small picture leaves it at 0
    engines[fine].setFinestScale(0 if fine else 1)
    return engines[fine]


def _calculated(engine: cv2.DISOpticalFlow, a: Grey, b: Grey, start: FloatMap | None) -> FloatMap:
    # Always with a start: without one, the engine uses the start of its last call.
    guess = np.zeros((*a.shape, 2), np.float32) if start is None else start
    return np.asarray(engine.calc(a, b, guess), np.float32)


@lru_cache(maxsize=2)
def grid_xy(height: int, width: int) -> tuple[FloatMap, FloatMap]:
    """x and y of every pixel, float32 (h, w) each; cached, so do not modify them."""
    yy, xx = np.mgrid[:height, :width].astype(np.float32)
    return xx, yy


def displaced(picture: NDArray[Any], by_px: FloatMap, how: int = cv2.INTER_LINEAR) -> NDArray[Any]:
    """A picture sampled by_px, float32 (h, w, 2) as (x, y), away from every pixel; the border is
    repeated.
    """
    xx, yy = grid_xy(*by_px.shape[:2])
    return np.asarray(
        cv2.remap(
            picture, xx + by_px[..., 0], yy + by_px[..., 1], how, borderMode=cv2.BORDER_REPLICATE
        )
    )


def returned_flow(a: Grey, b: Grey) -> tuple[FloatMap, Mask]:
    """The flow from a to b, and the pixels where the flow back returns to its start."""
    ahead, back = flow(a, b), flow(b, a)
    xx, yy = grid_xy(*ahead.shape[:2])
    returned = cv2.remap(
        back,
        xx + ahead[..., 0],
        yy + ahead[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(1e4, 1e4, 0, 0),
    )
    off = np.hypot(*cv2.split(ahead + returned))
    return ahead, off < RETURN_PX + _RETURN_SHARE * np.hypot(*cv2.split(ahead))


def robust_fit(
    matrix: NDArray[np.float64], values: NDArray[np.float64], tolerance: float
) -> NDArray[np.float64]:
    """Least-squares solution with Huber's weights: residuals above the tolerance, from parts with
    another motion, count by their amount and not by their square.
    """
    weights = np.ones(len(values))
    for _ in range(_FIT_ROUNDS):
        solution = np.linalg.lstsq(matrix * weights[:, None], values * weights, rcond=None)[0]
        weights = np.sqrt(
            np.minimum(1, tolerance / np.maximum(np.abs(values - matrix @ solution), 1e-9))
        )
    return np.asarray(solution, np.float64)


def without_shake(x: NDArray[np.intp], y: NDArray[np.intp], motion_px: FloatMap) -> FloatMap:
    """Motion of pixels at (x, y), float32 (n,) or (n, 2), without hand shake: the residual of a
    least-squares fit by shift, rotation and zoom.
    """
    places = np.stack((np.ones(len(x)), x, y), axis=1).astype(np.float32)
    return np.asarray(
        motion_px - places @ np.linalg.lstsq(places, motion_px, rcond=None)[0], np.float32
    )


def textured(picture: Grey) -> Mask:
    """The 20 % of the pixels with the strongest edges, unless those are too weak."""
    edges = np.abs(cv2.Sobel(picture, cv2.CV_32F, 1, 0)) + np.abs(
        cv2.Sobel(picture, cv2.CV_32F, 0, 1)
    )
    return np.asarray(edges > max(40.0, float(np.percentile(edges, 80))), bool)


@lru_cache(maxsize=2)
def grey_views(source: SceneSource, most_px: float = LOOK_PX) -> Callable[[int, int], Grey]:
    """Views by file index for optical flow: grey, 8 bit; dark (linear-light) scenes are brightened
    so that the flow finds texture.

    Views of more than most_px are reduced.
    """
    scale = min(1.0, math.sqrt(most_px / (source.height_px * source.width_px)))
    size = max(1, round(scale * source.width_px)), max(1, round(scale * source.height_px))

    def share(row: int, col: int) -> NDArray[np.float32]:
        if scale < 1 and source.small is not None:
            grey = cv2.resize(source.small(row, col, most_px), size, interpolation=cv2.INTER_AREA)
            return np.asarray(grey.astype(np.float32) * np.float32(1 / 255), np.float32)
        picture = source.read(source.telling, row, col)
        if scale < 1:
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        plane = (
            picture if picture.ndim == 2 else cv2.transform(picture, np.array([LUMA], np.float32))
        )
        return np.asarray(
            np.minimum(plane.astype(np.float32) * np.float32(1 / source.max_value), 1), np.float32
        )

    last = max(source.places, key=sum)
    lift = 0.5 if float(share(*last).mean()) < _DARK else 1.0

    @lru_cache(maxsize=64)
    def grey(row: int, col: int) -> Grey:
        return np.asarray(np.rint(255 * share(row, col) ** np.float32(lift)), np.uint8)

    return grey


def present_lines(source: SceneSource) -> tuple[list[ViewIndex], list[ViewIndex]]:
    """A row and a column of views that cross near the middle of the grid, without gaps."""

    def lines(row: int, col: int) -> tuple[list[ViewIndex], list[ViewIndex]]:
        return [(row, c) for c in range(source.cols)], [(r, col) for r in range(source.rows)]

    def key(place: ViewIndex) -> tuple[int, int]:
        off = abs(2 * place[0] - source.rows) + abs(2 * place[1] - source.cols)
        return sum(len(source.missing.intersection(line)) for line in lines(*place)), off

    across, down = lines(*min(np.ndindex(source.rows, source.cols), key=key))
    return _longest_run(across, source), _longest_run(down, source)


def _longest_run(line: list[ViewIndex], source: SceneSource) -> list[ViewIndex]:
    """The longest run of a line of views without a gap."""
    runs = [
        list(places)
        for is_present, places in groupby(line, lambda place: place not in source.missing)
        if is_present
    ]
    return max(runs, key=len, default=[])
