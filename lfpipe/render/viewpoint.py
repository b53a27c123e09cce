"""Eyes in the camera picture to viewpoints on the grid of views.

    col = c0 + (cx - u) / alpha        row = r0 + (v - cy) / alpha

(u, v) is an eye in px of the unmirrored camera picture, (cx, cy) the centre of the neutral viewer's eyes, (r0, c0) the middle of
the grid in canonical order. A viewer who moves right appears further left in the picture (smaller u) and looks from a camera
further right. Both eyes share the row of the point midway between them, so noise of the landmarks never becomes vertical
disparity. At the edge of the grid the middle of the eyes stops and their distance stays: parallax ends there, depth does not.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfpipe.config import Render
from lfpipe.config.quality import WARPS

Position = tuple[float, float]  # (row, col) in grid steps

HYSTERESIS_VIEWS = 0.1
_FAR = 1e12  # steps; larger values mean nothing and overflow


def soft_clamp(value: float, count: int, extrapolate_views: float) -> float:
    """value on an axis of `count` views: unchanged inside, compressed outside towards a limit of extrapolate_views beyond the
    edge.

    Value and slope are continuous: the picture never freezes at the edge, however far the viewer leans out. value must be finite.
    """
    return _limited(value, 0.0, count - 1.0, extrapolate_views)


def _limited(value: float, low: float, high: float, reach: float) -> float:
    """value between low and high; beyond them compressed towards `reach` further out."""
    inside = min(max(value, low), high)
    if reach <= 0 or value == inside:
        return inside
    return inside + reach * math.tanh((value - inside) / reach)


def pair_clamped(left: float, right: float, count: int, extrapolate_views: float) -> tuple[float, float]:
    """The columns of both eyes within a grid of `count` columns and extrapolate_views beyond it: their middle is clamped, and
    their distance stays unless the grid is narrower.

    Continuous, and the columns themselves while both are inside. left, right must be finite.
    """
    if min(left, right) >= 0 and max(left, right) <= count - 1:
        return left, right
    edge = (count - 1) / 2
    half = _limited((right - left) / 2, -edge, edge, extrapolate_views)
    room = max(edge - abs(half), 0.0)
    middle = edge + _limited((right + left) / 2 - edge, -room, room, max(edge + extrapolate_views - room - abs(half), 0.0))
    low, high = -extrapolate_views, count - 1 + extrapolate_views
    return min(max(middle - half, low), high), min(max(middle + half, low), high)


def extrapolation_views(method: str, render: Render) -> float:
    """Grid steps by which a viewpoint may lie outside the stored views."""
    return render.extrapolate_views if method in WARPS else 0.0


def snapped(value: float, held: float | None) -> float:
    """The whole view for value: the held one until value is HYSTERESIS_VIEWS past halfway to its neighbour."""
    if held is not None and abs(value - held) <= 0.5 + HYSTERESIS_VIEWS:
        return held
    return math.floor(value + 0.5)


class ViewSolver:
    """The mapping with its state: the neutral pose, and the views held in nearest mode.

    rows, cols: of the grid. render: extrapolate_views, keep_depth and swap_eyes are used. alpha_px: camera px between
    neighbouring views. centre_px: (cx, cy). method: in use; nearest gets whole views with hysteresis.
    """

    def __init__(
        self, rows: int, cols: int, render: Render, alpha_px: float, centre_px: ArrayLike, method: str = "warp2"
    ) -> None:
        self.rows, self.cols = rows, cols
        self.alpha_px = alpha_px
        centre = np.asarray(centre_px, dtype=np.float64).reshape(2)
        self.centre_px = (float(centre[0]), float(centre[1]))
        self._render = render
        self.draw_with(method)
        self._held: list[float | None] = [None, None, None]  # row, left col, right col

    def draw_with(self, method: str) -> None:
        """Sets the method in use: the last views are held in nearest mode, and only warps extrapolate."""
        self._snap, self._reach = method == "nearest", extrapolation_views(method, self._render)

    def neutral(self) -> Position:
        """The middle of the grid, where a viewer is assumed to be until seen."""
        return (self.rows - 1) / 2, (self.cols - 1) / 2

    def _alpha(self) -> float:
        """alpha_px, positive; infinite where it is not finite."""
        return abs(self.alpha_px) if math.isfinite(self.alpha_px) else math.inf

    def _steps(self, distance_px: float) -> float:
        """distance over alpha, always finite; NaN counts as 0."""
        steps = distance_px / max(self._alpha(), 1e-300) if math.isfinite(distance_px) else distance_px
        return 0.0 if math.isnan(steps) else min(max(steps, -_FAR), _FAR)

    def beyond(self, eyes_px: ArrayLike) -> bool:
        """Whether both eyes, (2, 2) px, are beyond the same side of the grid, where motion hardly changes the picture."""
        eyes = np.asarray(eyes_px, dtype=np.float64).reshape(2, 2)
        cols = [self._steps(self.centre_px[0] - float(u)) for u in eyes[:, 0]]
        row = self._steps(float(eyes[:, 1].mean()) - self.centre_px[1])
        half_cols, half_rows = (self.cols - 1) / 2, (self.rows - 1) / 2
        return min(cols) > half_cols or max(cols) < -half_cols or (self.rows > 1 and abs(row) > half_rows)

    def dragged(self, centre_px: ArrayLike, eyes_px: ArrayLike) -> NDArray[np.float64]:
        """The neutral position nearest to centre_px, (2,), that puts the eyes, (2, 2) px, within the grid if they fit."""
        eyes = np.asarray(eyes_px, dtype=np.float64).reshape(2, 2)
        half = abs(float(eyes[0, 0] - eyes[1, 0])) / 2
        alpha = min(self._alpha(), _FAR)
        room = np.array([max((self.cols - 1) / 2 * alpha - half, 0.0), (self.rows - 1) / 2 * alpha])
        middle = eyes.mean(axis=0)
        return np.clip(np.asarray(centre_px, np.float64), middle - room, middle + room)

    def views(self, eyes_px: ArrayLike) -> tuple[Position, Position]:
        """Viewpoints ((row, col) left, (row, col) right) for the eyes, (2, 2) px: left (u, v), right (u, v).

        Always finite and within the grid plus extrapolate_views. An eye that is NaN looks from the neutral view.
        """
        (left_u, left_v), (right_u, right_v) = np.asarray(eyes_px, dtype=np.float64).reshape(2, 2).tolist()
        r0, c0 = self.neutral()
        cx, cy = self.centre_px
        middle_v = left_v / 2 + right_v / 2  # halve first: the sum of two finite numbers may overflow
        # a single row knows nothing above and below it: its height is left out
        row = soft_clamp(r0 + self._steps(middle_v - cy), self.rows, self._reach if self.rows > 1 else 0.0)
        left, right = c0 + self._steps(cx - left_u), c0 + self._steps(cx - right_u)
        if self._render.keep_depth:
            left, right = pair_clamped(left, right, self.cols, self._reach)
        else:
            left, right = (soft_clamp(col, self.cols, self._reach) for col in (left, right))
        if self._snap:
            row, left, right = (snapped(value, held) for value, held in zip((row, left, right), self._held, strict=True))
            self._held = [row, left, right]
        if self._render.swap_eyes:
            left, right = right, left
        return (row, left), (row, right)
