"""The order of views from optical flow between a few of them, without truth.

In canonical order a step to the next column moves everything sideways by -d and a step to the next row moves it upwards by the
same d. So the direction of motion shows a transpose, and the sign of the correlation of the two the flip of one axis. The
half-turn changes neither; it exchanges near and far. Two properties of the pictures show it: occlusion (splatted along the row,
the picture must agree where two surfaces meet, with the nearer one in front) and, weakly, height: lower parts of a picture are
usually nearer. Only flow confirmed by the way back counts: the rest is guesswork.
"""

import math
from collections.abc import Callable
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.disparity import view_disparity
from lfpipe.scene.optical_flow import FloatMap, Grey, Mask, confirmed, flow, textured

GreyAt = Callable[[int], Grey]

_ENOUGH_PX = 3.0  # spread of the flow that separates surfaces
_OVERLAP_PX = 1.5  # two surfaces meet if one splat lands on another this much nearer
_DIFFERENT, _SAME, _WRONG = 10, 3, 6  # grey levels
_PLACES, _CLEAR = 20, 3  # along the shorter side of a view, with one vote each, because pixels at one edge agree; their majority
LOWER = 0.35  # correlation of height with disparity
_FEWEST = 200  # fewer reliable pixels mean nothing


@attrs.frozen
class Axis:
    """One axis of the file grid, seen from its middle view.

    sideways: views differ along x (else along y). disparity: float32 (h, w), px per step as if file order were canonical.
    reliable: bool (h, w), where the flow is confirmed. along_px, across_px: motion per step along the axis and across it.
    right, wrong: places where the hidden surface is the farther one, and the nearer one.
    """

    sideways: bool
    disparity: FloatMap
    reliable: Mask
    along_px: float
    across_px: float
    right: int
    wrong: int


def _sharpened(disparity_px: FloatMap, picture: Grey) -> FloatMap:
    """The map with its edges moved to those of the picture (weighted median), because occlusion shows only at edges."""
    low, high = (float(v) for v in np.percentile(disparity_px, (0.5, 99.5)))
    if high - low < 1e-3:
        return disparity_px
    steps = np.clip((disparity_px - low) * np.float32(255 / (high - low)), 0, 255).astype(np.uint8)
    sharp = cv2.ximgproc.weightedMedianFilter(picture, steps, 7, sigma=12.0)
    return np.asarray(sharp, np.float32) * np.float32((high - low) / 255) + np.float32(low)


def _splat(order: NDArray[np.intp], disparity_px: FloatMap, steps: int, sideways: bool) -> NDArray[np.intp]:
    """The pixel of a view that lands on each pixel of the view `steps` further; of several, the last in `order`; -1 for none."""
    height, width = disparity_px.shape
    y, x = np.divmod(order, width)
    shift = np.rint(disparity_px.ravel()[order] * np.float32(steps)).astype(np.intp)
    x, y = (x - shift, y) if sideways else (x, y - shift)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    out = np.full(height * width, -1, np.intp)
    out[(y * width + x)[inside]] = order[inside]
    return out


def _votes(here: Grey, disparity_px: FloatMap, reliable: Mask, there: Grey, steps: int, sideways: bool) -> NDArray[np.int32]:
    """By pixel of a view, int32 (h, w): 1 where two surfaces meet in the view `steps` further and that shows the nearer one,
    -1 where it shows the farther one."""
    near_last = np.argsort(disparity_px.ravel(), kind="stable")
    front = _splat(near_last, disparity_px, steps, sideways)
    back = _splat(near_last[::-1], disparity_px, steps, sideways)
    colour, depth, known = here.ravel().astype(np.float32), disparity_px.ravel(), reliable.ravel()
    meet = (front >= 0) & ((depth[front] - depth[back]) * abs(steps) > _OVERLAP_PX)
    meet &= (np.abs(colour[front] - colour[back]) > _DIFFERENT) & known[front] & known[back]
    seen = (front >= 0) & known[front] & (colour[front] > _DIFFERENT)
    # Exposure may differ from view to view by more than surfaces do.
    gain = float(np.median(colour[front[seen]] / np.maximum(there.ravel()[seen], 1))) if seen.any() else 1.0
    around = np.ones((3, 3), np.uint8)  # one px of tolerance: the splat rounds
    low, high = (np.float32(gain) * edge(there, around).ravel()[meet] for edge in (cv2.erode, cv2.dilate))
    front_off, back_off = (np.abs(np.clip(values, low, high) - values) for values in (colour[front[meet]], colour[back[meet]]))
    out = np.zeros(here.size, np.int32)
    np.add.at(out, front[meet], (front_off < _SAME) & (back_off > _WRONG))
    np.subtract.at(out, front[meet], (back_off < _SAME) & (front_off > _WRONG))
    return out.reshape(here.shape)


def _motion_px(flow_px: FloatMap, use: Mask) -> NDArray[np.float64]:
    """Amount of motion along x and y, float64 (2,): the spread between surfaces and their common motion, because a flat wall
    moves as one. flow_px: float32 (h, w, 2); use: pixels that count, if they are enough."""
    values = flow_px[use] if np.count_nonzero(use) >= _FEWEST else flow_px.reshape(-1, 2)
    low, middle, high = np.percentile(values, (5, 50, 95), axis=0)
    return np.asarray(high - low + np.abs(middle), np.float64)


def examine_axis(grey: GreyAt, count: int) -> Axis | None:
    """Evidence from the views grey(0) .. grey(count - 1) along one axis of the grid; None if there are fewer than two."""
    if count < 2:
        return None
    base = count // 2
    here, sides = grey(base), [side for side in (1, -1) if 0 <= base + side < count]
    detail = textured(here)
    # Motion grows with the step: choose a step with enough motion.
    near_px = float(_motion_px(flow(here, grey(base + sides[0])), detail).max())
    step = max(1, min(int(_ENOUGH_PX / max(near_px, 0.1)) + 1, *(base if side < 0 else count - 1 - base for side in sides)))
    others = [(side * step, grey(base + side * step)) for side in sides]
    flows = [flow(here, there) for _, there in others]
    returned = [confirmed(ahead, flow(there, here)) for ahead, (_, there) in zip(flows, others, strict=True)]
    x_px, y_px = (_motion_px(flows[0], returned[0] & detail) / step).tolist()
    sideways, reliable = x_px >= y_px, np.logical_or.reduce(returned)
    found = view_disparity(here, [(there, 0.0 if sideways else steps, steps if sideways else 0.0) for steps, there in others])
    low, high = np.percentile(found, (5, 95))
    fars = [far for far in {0, base // 2, (base + count - 1) // 2, count - 1} if abs(far - base) * (high - low) > 2]
    sharp = _sharpened(found, here) if fars else found
    votes = sum((_votes(here, sharp, reliable, grey(far), far - base, sideways) for far in fars), np.zeros(here.shape, np.int32))
    side = max(4, min(here.shape) // _PLACES)
    rows, cols = (size // side for size in here.shape)
    places = votes[: rows * side, : cols * side].reshape(rows, side, cols, side).sum(axis=(1, 3))
    right, wrong = (int(np.count_nonzero(sign * places >= _CLEAR)) for sign in (1, -1))
    return Axis(sideways, found, reliable & detail, max(x_px, y_px), min(x_px, y_px), right, wrong)


def _correlation(a: NDArray[Any], b: NDArray[Any]) -> float:
    """0 if the values are too few, or do not vary."""
    if len(a) < _FEWEST or min(a.std(), b.std()) < 1e-6:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def same_way(a: Axis, b: Axis) -> float:
    """Correlation of the two axes' disparities at pixels reliable in both: near 1 in a well-ordered grid, near -1 with one axis
    reversed."""
    use = a.reliable & b.reliable
    first, second = a.disparity[use], b.disparity[use]
    alike = _correlation(first, second)
    # A flat wall has nothing to correlate, but it moves as one, by the same amount along both axes.
    if abs(alike) < 0.5 and len(first) >= _FEWEST and all(abs(v.mean()) > max(0.3, 3 * v.std()) for v in (first, second)):
        ratio = float(first.mean() / second.mean())
        return math.copysign(0.9, ratio) if 0.5 < abs(ratio) < 2 else alike
    return alike


def lower_is_nearer(disparity: FloatMap, use: Mask) -> float:
    """Correlation of height in the picture with disparity: positive if lower parts are nearer; below LOWER it means little."""
    return _correlation(np.nonzero(use)[0], disparity[use])
