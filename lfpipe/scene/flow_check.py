"""The order of views from optical flow between a few of them, without truth.

In canonical order a step to the next column moves everything sideways by -d and a step to the next row moves it upwards by the
same d. So the direction of motion shows a transpose, and the sign of the correlation of the two the flip of one axis. The
half-turn changes neither; it exchanges near and far. Two properties of the pictures show it: occlusion (splatted along the row,
the picture must agree where two surfaces meet, with the nearer one in front) and, weakly, height: lower parts of a picture are
usually nearer. Only flow confirmed by the way back counts: the rest is guesswork.
"""

from __future__ import annotations

from collections.abc import Callable

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.disparity import Grey, flow, grid_xy, view_disparity

GreyAt = Callable[[int], Grey]
FloatMap = NDArray[np.float32]
Mask = NDArray[np.bool_]

_ENOUGH_PX = 3.0  # spread of the flow that separates surfaces
_OVERLAP_PX = 1.5  # two surfaces meet if one splat lands on another this much nearer
_DIFFERENT, _SAME, _WRONG = 10, 3, 6  # grey levels
_RETURN_PX, _RETURN_SHARE = 0.5, 0.1  # tolerance of flow followed back: px, and share of the way
_CLEAR = 500.0  # square of the majority over all votes: enough to skip the other views
_FEWEST = 200  # fewer reliable pixels mean nothing


@attrs.frozen
class Axis:
    """One axis of the file grid, seen from its middle view.

    sideways: views differ along x (else along y). disparity: float32 (h, w), px per step as if file order were canonical.
    reliable: bool (h, w), where the flow is confirmed. along_px, across_px: motion per step along the axis and across it.
    right, wrong: pixels where the hidden surface is the farther one, and the nearer one.
    """

    sideways: bool
    disparity: FloatMap
    reliable: Mask
    along_px: float
    across_px: float
    right: int
    wrong: int


def _spread(values: NDArray[np.float32]) -> float:
    low, high = np.percentile(values, (5, 95))
    return float(high - low)


def _motion(values: FloatMap) -> float:
    """Amount of motion: the spread between surfaces and their common motion, because a flat wall moves as one."""
    return _spread(values) + abs(float(np.median(values)))


def confirmed(there: FloatMap, back: FloatMap) -> Mask:
    """The pixels whose flow to another view, followed back, returns to its start. float32 (h, w, 2) each."""
    xx, yy = grid_xy(*there.shape[:2])
    returned = cv2.remap(back, xx + there[..., 0], yy + there[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
                         borderValue=(1e4, 1e4, 0, 0))  # fmt: skip
    off = np.hypot(there[..., 0] + returned[..., 0], there[..., 1] + returned[..., 1])
    return np.asarray(off < _RETURN_PX + _RETURN_SHARE * np.hypot(there[..., 0], there[..., 1]), bool)


def textured(picture: Grey) -> Mask:
    """The fifth of the pixels with the strongest edges, unless they are too weak."""
    edges = np.abs(cv2.Sobel(picture, cv2.CV_32F, 1, 0)) + np.abs(cv2.Sobel(picture, cv2.CV_32F, 0, 1))
    return np.asarray(edges > max(40.0, float(np.percentile(edges, 80))), bool)


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


def _votes(here: Grey, disparity_px: FloatMap, reliable: Mask, there: Grey, steps: int, sideways: bool) -> tuple[int, int]:
    """(right, wrong): pixels of the view `steps` further that show the nearer, the farther of two surfaces that meet there."""
    near_last = np.argsort(disparity_px.ravel(), kind="stable")
    front = _splat(near_last, disparity_px, steps, sideways)
    back = _splat(near_last[::-1], disparity_px, steps, sideways)
    colour, depth, known = here.ravel().astype(np.float32), disparity_px.ravel(), reliable.ravel()
    seen = there.ravel().astype(np.float32)
    sure = (front >= 0) & known[front] & (colour[front] > _DIFFERENT)
    # Exposure may differ from view to view by more than surfaces do.
    gain = float(np.median(colour[front[sure]] / np.maximum(seen[sure], 1))) if sure.any() else 1.0
    meet = (front >= 0) & ((depth[front] - depth[back]) * abs(steps) > _OVERLAP_PX)
    meet &= (np.abs(colour[front] - colour[back]) > _DIFFERENT) & known[front] & known[back]
    around = np.ones((3, 3), np.uint8)  # one px of tolerance: the splat rounds
    low, high = (gain * edge(there, around).ravel().astype(np.float32)[meet] for edge in (cv2.erode, cv2.dilate))
    front_off, back_off = (
        np.maximum(np.maximum(low - colour[pixel[meet]], colour[pixel[meet]] - high), 0) for pixel in (front, back)
    )
    right = int(np.count_nonzero((front_off < _SAME) & (back_off > _WRONG)))
    return right, int(np.count_nonzero((back_off < _SAME) & (front_off > _WRONG)))


def examine_axis(grey: GreyAt, count: int) -> Axis | None:
    """Evidence from the views grey(0) .. grey(count - 1) along one axis of the grid; None if there are fewer than two.

    Starts with the middle view and adds others only while there is too little evidence of occlusion.
    """
    if count < 2:
        return None
    middle: Axis | None = None
    right = wrong = 0
    bases = [count // 2] if count < 5 else [count // 2, max(1, count // 6), min(count - 2, count - 1 - count // 6)]
    for base in bases:
        if (right - wrong) ** 2 > _CLEAR * (right + wrong):
            break
        here, room = grey(base), max(1, min(base, count - 1 - base))
        detail = textured(here)
        use = detail if np.count_nonzero(detail) >= _FEWEST else np.ones_like(detail)
        step = 1
        while True:
            other = base + step if base + step < count else base - step
            sign = np.float32(1 if other > base else -1)
            shift = flow(here, grey(other)) * sign
            spans = _motion(shift[use, 0]), _motion(shift[use, 1])
            if max(spans) >= _ENOUGH_PX or step >= room:
                break
            # motion grows with the step: choose a step with enough motion
            step = min(room, max(step + 1, int(step * _ENOUGH_PX / max(max(spans), 0.1))))
        sides = [s for s in (step, -step) if 0 <= base + s < count]
        reliable = np.zeros(here.shape, bool)
        for s in sides:
            there = shift * sign if base + s == other else flow(here, grey(base + s))
            back = confirmed(there, flow(grey(base + s), here))
            reliable |= back
            if base + s == other and np.count_nonzero(back & use) >= _FEWEST:
                spans = _motion(shift[back & use, 0]), _motion(shift[back & use, 1])
        sideways = spans[0] >= spans[1] if middle is None else middle.sideways
        toward = (0.0, 1.0) if sideways else (1.0, 0.0)
        found = view_disparity(here, [(grey(base + s), toward[0] * s, toward[1] * s) for s in sides])
        found = np.asarray(cv2.medianBlur(found, 5), np.float32)
        fars = [far for far in {0, base // 2, (base + count - 1) // 2, count - 1} if abs(far - base) * _spread(found) > 2]
        sharp = _sharpened(found, here) if fars else found
        for far in fars:
            more = _votes(here, sharp, reliable, grey(far), far - base, sideways)
            right, wrong = right + more[0], wrong + more[1]
        if middle is None:
            along, across = spans if sideways else spans[::-1]
            middle = Axis(sideways, found, reliable & detail, along / step, across / step, 0, 0)
        if not fars:  # no surface lies before another, in no view
            break
    return attrs.evolve(middle, right=right, wrong=wrong) if middle else None


def same_way(a: Axis, b: Axis) -> float:
    """Correlation of the two axes' disparities at pixels reliable in both: near 1 in a well-ordered grid, near -1 with one axis
    reversed; 0 if too few are reliable."""
    use = a.reliable & b.reliable
    if np.count_nonzero(use) < _FEWEST:
        return 0.0
    first, second = (np.asarray(axis.disparity[use], np.float64) for axis in (a, b))
    means, spreads = (float(first.mean()), float(second.mean())), (float(first.std()), float(second.std()))
    alike = float(np.corrcoef(first, second)[0, 1]) if min(spreads) > 1e-6 else 0.0
    together = all(abs(mean) > max(0.3, 3 * spread) for mean, spread in zip(means, spreads, strict=True))
    # a flat wall has nothing to correlate, but it moves as one, by the same amount along both axes
    if abs(alike) < 0.5 and together and 0.5 < abs(means[0] / means[1]) < 2:
        return 0.9 if means[0] * means[1] > 0 else -0.9
    return alike


def lower_is_nearer(axes: list[tuple[Axis, int]]) -> float:
    """Correlation of height in the picture with disparity, over axes with the sign that brings each to one order: positive if
    lower parts are nearer. 0 if too few pixels are reliable or nothing varies."""
    found = 0.0
    for axis, sign in axes:
        y = np.nonzero(axis.reliable)[0]
        values = axis.disparity[axis.reliable]
        if len(y) >= _FEWEST and values.std() > 1e-6 and y.std() > 0:
            found += sign * float(np.corrcoef(y, values)[0, 1]) / len(axes)
    return found
