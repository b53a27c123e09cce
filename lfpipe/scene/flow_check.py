"""What optical flow between a few views says about their order, with no truth at hand.

In canonical order a step to the next column moves everything sideways by -d and a step to the next row moves it upwards by
the same d. So the direction of motion tells a transpose, the sign of the correlation of the two tells the flip of one axis.
The half-turn leaves both as they are; it exchanges near and far, and is settled by who hides whom: splatted along the row,
the picture must agree where two surfaces meet, with the nearer one in front.
"""

from __future__ import annotations

from collections.abc import Callable

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.disparity import Grey, flow, view_disparity

GreyAt = Callable[[int], Grey]
FloatMap = NDArray[np.float32]

_ENOUGH_PX = 3.0  # spread of the flow that tells surfaces apart
_OVERLAP_PX = 1.5  # two surfaces meet where one splat lands on another this much nearer
_DIFFERENT, _SAME, _WRONG = 10, 3, 6  # grey levels


@attrs.frozen
class Axis:
    """One axis of the file grid. sideways: its views differ along x (else along y). disparity: float32 (h, w) of the middle
    view in px per step as if file order were canonical along that axis. along_px, across_px: motion per step
    along the direction of the axis and across it.
    right, wrong: pixels where the hidden surface is the farther one, and the nearer one."""

    sideways: bool
    disparity: FloatMap
    textured: NDArray[np.bool_]
    along_px: float
    across_px: float
    right: int
    wrong: int

    @property
    def sign(self) -> int:
        """1: order as in the file, -1: reversed, 0: not told, by occlusion."""
        if self.right + self.wrong < 40:
            return 0
        return 1 if self.right > 2.5 * self.wrong else -1 if self.wrong > 2.5 * self.right else 0

    @property
    def one_way(self) -> int:
        """1 or -1 where everything moves the same way and far from standing still, as parallel cameras see it; else 0."""
        low, high = np.percentile(self.disparity[self.textured], (1, 99)) if self.textured.any() else (0.0, 0.0)
        if min(abs(low), abs(high)) < max(0.5, 0.75 * (high - low)) or low * high <= 0:
            return 0
        return 1 if low > 0 else -1


def _spread(values: FloatMap) -> float:
    low, high = np.percentile(values, (5, 95))
    return float(high - low)


def _motion(values: FloatMap) -> float:
    """How much moves: what surfaces differ by and what they have in common, as a flat wall moves as one."""
    return _spread(values) + abs(float(np.median(values)))


def _sharpened(disparity_px: FloatMap, picture: Grey) -> FloatMap:
    """The map with its edges drawn to those of the picture (weighted median), as who hides whom shows at edges only."""
    low, high = (float(v) for v in np.percentile(disparity_px, (0.5, 99.5)))
    if high - low < 1e-3:
        return disparity_px
    steps = np.clip((disparity_px - low) * np.float32(255 / (high - low)), 0, 255).astype(np.uint8)
    sharp = cv2.ximgproc.weightedMedianFilter(picture, steps, 7, sigma=12.0)
    return np.asarray(sharp, np.float32) * np.float32((high - low) / 255) + np.float32(low)


def _splat(
    values: FloatMap, disparity_px: FloatMap, steps: int, sideways: bool, order: NDArray[np.intp]
) -> tuple[FloatMap, NDArray[np.bool_]]:
    """values carried `steps` views on, written in `order` (the last one stays), and where anything landed."""
    height, width = values.shape
    y, x = np.divmod(order, width)
    shift = np.rint(disparity_px.ravel()[order] * np.float32(steps)).astype(np.intp)
    x, y = (x - shift, y) if sideways else (x, y - shift)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    place = (y * width + x)[inside]
    out, hit = np.zeros(height * width, np.float32), np.zeros(height * width, bool)
    out[place], hit[place] = values.ravel()[order[inside]], True
    return out.reshape(height, width), hit.reshape(height, width)


def _votes(here: Grey, disparity_px: FloatMap, there: Grey, steps: int, sideways: bool) -> tuple[int, int]:
    """(right, wrong): pixels of the view `steps` on that show the nearer, the farther of two surfaces that meet there."""
    near_last = np.argsort(disparity_px.ravel(), kind="stable")
    colour = here.astype(np.float32)
    depth_front, hit = _splat(disparity_px, disparity_px, steps, sideways, near_last)
    depth_back, _ = _splat(disparity_px, disparity_px, steps, sideways, near_last[::-1])
    front, _ = _splat(colour, disparity_px, steps, sideways, near_last)
    back, _ = _splat(colour, disparity_px, steps, sideways, near_last[::-1])
    meet = hit & ((depth_front - depth_back) * abs(steps) > _OVERLAP_PX) & (np.abs(front - back) > _DIFFERENT)
    around = np.ones((3, 3), np.uint8)  # one px of tolerance: the splat rounds
    low, high = cv2.erode(there, around).astype(np.float32), cv2.dilate(there, around).astype(np.float32)
    front_off = np.maximum(np.maximum(low - front, front - high), 0)[meet]
    back_off = np.maximum(np.maximum(low - back, back - high), 0)[meet]
    right = int(np.count_nonzero((front_off < _SAME) & (back_off > _WRONG)))
    return right, int(np.count_nonzero((back_off < _SAME) & (front_off > _WRONG)))


def examine_axis(grey: GreyAt, count: int) -> Axis | None:
    """What the views grey(0) .. grey(count - 1) along one axis of the grid say; None where there are fewer than two."""
    if count < 2:
        return None
    right = wrong = 0
    middle: Axis | None = None
    bases = [count // 2] if count < 5 else [count // 2, max(1, count // 6), min(count - 2, count - 1 - count // 6)]
    for base in bases:
        here, room = grey(base), max(1, min(base, count - 1 - base))
        step, shift = 1, np.zeros((*here.shape, 2), np.float32)
        while True:
            other = base + step if base + step < count else base - step
            shift = flow(here, grey(other)) * np.float32(1 if other > base else -1)
            spans = _motion(shift[..., 0]), _motion(shift[..., 1])
            if max(spans) >= _ENOUGH_PX or step + 1 > room:
                break
            step += 1
        sideways = spans[0] >= spans[1] if middle is None else middle.sideways
        toward = (0.0, 1.0) if sideways else (1.0, 0.0)
        beside = [(grey(base + s), toward[0] * s, toward[1] * s) for s in (step, -step) if 0 <= base + s < count]
        found = np.asarray(cv2.medianBlur(view_disparity(here, beside), 5), np.float32)
        sharp = _sharpened(found, here)
        for far in {0, base // 2, (base + count - 1) // 2, count - 1}:
            if abs(far - base) * _spread(found) > 2:
                more = _votes(here, sharp, grey(far), far - base, sideways)
                right, wrong = right + more[0], wrong + more[1]
        if middle is None:
            edges = np.abs(cv2.Sobel(here, cv2.CV_32F, 1, 0)) + np.abs(cv2.Sobel(here, cv2.CV_32F, 0, 1))
            textured = edges > max(40.0, float(np.percentile(edges, 80)))
            along, across = spans if sideways else spans[::-1]
            middle = Axis(sideways, found, textured, along / step, across / step, 0, 0)
    return attrs.evolve(middle, right=right, wrong=wrong) if middle else None


def same_way(a: Axis, b: Axis) -> float:
    """Correlation of the two axes' disparities where there is texture: near 1 in a well ordered grid, near -1 with one axis
    reversed."""
    both = a.textured & b.textured
    use = both if np.count_nonzero(both) > 100 else np.ones_like(both)
    first, second = (np.asarray(axis.disparity[use], np.float64) for axis in (a, b))
    means, spreads = (float(first.mean()), float(second.mean())), (float(first.std()), float(second.std()))
    alike = float(np.corrcoef(first, second)[0, 1]) if min(spreads) > 1e-6 else 0.0
    together = all(abs(mean) > max(0.3, 3 * spread) for mean, spread in zip(means, spreads, strict=True))
    # A flat wall has nothing to correlate, but it moves as one, by the same amount along both axes.
    if abs(alike) < 0.5 and together and 0.5 < abs(means[0] / means[1]) < 2:
        return 0.9 if means[0] * means[1] > 0 else -0.9
    return alike
