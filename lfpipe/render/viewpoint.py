"""Eyes in the camera picture to viewpoints on the grid of views.

    col = c0 + (cx - u) / alpha        row = r0 + (v - cy) / alpha

(u, v) is an eye in px of the unmirrored camera picture, (cx, cy) the centre of the neutral viewer's eyes, (r0, c0) the middle of
the grid in canonical order. A viewer who moves right appears further left in the picture (smaller u) and looks from a camera
further right. Both eyes share the row of the point midway between them, so noise of the landmarks never becomes vertical
disparity.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfpipe.config import Render

Position = tuple[float, float]  # (row, col) in grid steps

HYSTERESIS_VIEWS = 0.1
_FAR = 1e12  # steps; larger values mean nothing and overflow


def soft_clamp(value: float, count: int, extrapolate_views: float) -> float:
    """value on an axis of `count` views: unchanged inside, compressed outside towards a limit of extrapolate_views beyond the
    edge.

    Value and slope are continuous: the picture never freezes at the edge, however far the viewer leans out. value must be finite.
    """
    edge = count - 1.0
    inside = min(max(value, 0.0), edge)
    if extrapolate_views <= 0 or value == inside:
        return inside
    return inside + extrapolate_views * math.tanh((value - inside) / extrapolate_views)


def snapped(value: float, held: float | None) -> float:
    """The whole view for value: the held one until value is HYSTERESIS_VIEWS past halfway to its neighbour."""
    if held is not None and abs(value - held) <= 0.5 + HYSTERESIS_VIEWS:
        return held
    return math.floor(value + 0.5)


class ViewSolver:
    """The mapping with its state: the neutral pose, and the views held in nearest mode.

    rows, cols: of the grid. render: extrapolate_views and swap_eyes are used. alpha_px: camera px between neighbouring views.
    centre_px: (cx, cy). snap: give whole views with hysteresis, for the method nearest.
    """

    def __init__(self, rows: int, cols: int, render: Render, alpha_px: float, centre_px: ArrayLike, snap: bool = False) -> None:
        self.rows, self.cols = rows, cols
        self.alpha_px = alpha_px
        centre = np.asarray(centre_px, dtype=np.float64).reshape(2)
        self.centre_px = (float(centre[0]), float(centre[1]))
        self._render, self.snap = render, snap
        self._held: list[float | None] = [None, None, None]  # row, left col, right col

    def neutral(self) -> Position:
        """The middle of the grid, where a viewer is assumed to be until seen."""
        return (self.rows - 1) / 2, (self.cols - 1) / 2

    def _steps(self, distance_px: float) -> float:
        """distance over alpha, always finite; NaN counts as 0."""
        alpha = abs(self.alpha_px) if math.isfinite(self.alpha_px) else math.inf
        steps = distance_px / max(alpha, 1e-300) if math.isfinite(distance_px) else distance_px
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
        room = np.array([max((self.cols - 1) / 2 * self.alpha_px - half, 0.0), (self.rows - 1) / 2 * self.alpha_px])
        middle = eyes.mean(axis=0)
        return np.clip(np.asarray(centre_px, np.float64), middle - room, middle + room)

    def views(self, eyes_px: ArrayLike) -> tuple[Position, Position]:
        """Viewpoints ((row, col) left, (row, col) right) for the eyes, (2, 2) px: left (u, v), right (u, v).

        Always finite and within the grid plus extrapolate_views. An eye that is NaN looks from the neutral view.
        """
        (left_u, left_v), (right_u, right_v) = np.asarray(eyes_px, dtype=np.float64).reshape(2, 2).tolist()
        r0, c0 = self.neutral()
        cx, cy = self.centre_px
        reach = self._render.extrapolate_views
        middle_v = left_v / 2 + right_v / 2  # halve first: the sum of two finite numbers may overflow
        found = [
            soft_clamp(r0 + self._steps(middle_v - cy), self.rows, reach),
            soft_clamp(c0 + self._steps(cx - left_u), self.cols, reach),
            soft_clamp(c0 + self._steps(cx - right_u), self.cols, reach),
        ]
        if self.snap:
            counts = (self.rows, self.cols, self.cols)
            found = [
                min(max(snapped(value, held), 0.0), count - 1.0)
                for value, held, count in zip(found, self._held, counts, strict=True)
            ]
            self._held = list(found)
        row, left, right = found
        if self._render.swap_eyes:
            left, right = right, left
        return (row, left), (row, right)
