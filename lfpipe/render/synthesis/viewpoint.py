"""Maps eyes in the camera picture to viewpoints on the view grid, and viewpoints to the stored
views for a picture.

    col = c0 + (cx - u) / alpha        row = r0 + (v - cy) / alpha

(u, v) is an eye in px of the unmirrored camera picture, (cx, cy) the centre of the neutral viewer's
eyes, (r0, c0) the middle of the grid in canonical order. A viewer who moves right appears further
left in the picture (smaller u) and sees the view of a camera further right. Both eyes share the row
of their midpoint, so landmark noise never becomes vertical disparity. At the edge of the grid, the
midpoint is clamped and the eye distance is kept: parallax ends there, depth does not.
"""

import math
from typing import NamedTuple

from lfpipe.config import Render
from lfpipe.config.quality import WARPS
from lfpipe.eyes import Eyes
from lfpipe.scene.lightfield import LightField

Position = tuple[float, float]  # (row, col) in grid steps
Place = tuple[float, float, float]  # row of both eyes, column of the left and of the right one

HYSTERESIS_VIEWS = 0.1  # more than the jitter of still eyes
_FAR = 1e12  # steps; larger values are meaningless and overflow

# Half the width, in views, of the zone in which warp2 fades from one stored view to the next.
# Against fading all the way (antinous): nothing lost with every 2nd view kept, 0.3 dB with every
# 4th, largest over median step of a sweep 2.1 instead of 2.0,
# and half as many views to warp on average.
ROW_FADE, COL_FADE = 0.1, 0.25
# Where four views meet, at most this is taken from each of their shares, so that mostly two remain:
# a picture of all four for both eyes costs twice the median. Shares change at most 4 instead of 2
# times as fast there as the position.
SPARED_SHARE = 1 / 8


def limited(value: float, low: float, high: float, reach: float) -> float:
    """value between low and high, which is unchanged; beyond them compressed towards `reach`
    further out.

    Value and slope are continuous: the picture never freezes at the edge, however far the viewer
    leans out. value must be finite.
    """
    inside = min(max(value, low), high)
    if reach <= 0 or value == inside:
        return inside
    return inside + reach * math.tanh((value - inside) / reach)


def pair_clamped(
    left: float, right: float, count: int, extrapolate_views: float
) -> tuple[float, float]:
    """The columns of both eyes within a grid of `count` columns and extrapolate_views beyond it:
    their middle is clamped, and their distance stays unless the grid is narrower.

    Continuous, and the columns themselves while both are inside. left, right must be finite.
    """
    if min(left, right) >= 0 and max(left, right) <= count - 1:
        return left, right
    edge = (count - 1) / 2
    half = limited((right - left) / 2, -edge, edge, extrapolate_views)
    room = max(edge - abs(half), 0.0)
    middle = edge + limited(
        (right + left) / 2 - edge,
        -room,
        room,
        max(edge + extrapolate_views - room - abs(half), 0.0),
    )
    low, high = -extrapolate_views, count - 1 + extrapolate_views
    return min(max(middle - half, low), high), min(max(middle + half, low), high)


def extrapolation_views(method: str, render: Render) -> float:
    """Grid steps by which a viewpoint may lie outside the stored views."""
    return render.extrapolate_views if method in WARPS else 0.0


def _snapped(value: float, view: float) -> float:
    """The whole view for value: as before, `view`, until value is HYSTERESIS_VIEWS past halfway to
    its neighbour; NaN: there was none.
    """
    return view if abs(value - view) <= 0.5 + HYSTERESIS_VIEWS else math.floor(value + 0.5)


class ViewSolver:
    """The mapping with its state: the neutral position, and the views held in nearest mode.

    rows, cols: of the grid. render: extrapolate_views, keep_depth and swap_eyes are used. alpha_px:
    camera px between neighbouring views. centre_px: (cx, cy). method: in use; nearest gets whole
    views with hysteresis.
    """

    def __init__(
        self,
        rows: int,
        cols: int,
        render: Render,
        alpha_px: float,
        centre_px: tuple[float, float],
        method: str = "warp2",
    ) -> None:
        self.rows, self.cols = rows, cols
        self._render = render
        self._middle = (rows - 1) / 2, (cols - 1) / 2
        self.alpha_px = alpha_px
        self.centre_px = centre_px
        self.set_method(method)
        self._whole: Place = (math.nan, math.nan, math.nan)  # the last views of nearest mode

    def set_method(self, method: str) -> None:
        """Sets the method in use: the last views are held in nearest mode, and only warps
        extrapolate.
        """
        self._snap = method == "nearest"
        self._reach = extrapolation_views(method, self._render)

    def _steps(self, distance_px: float) -> float:
        """distance over alpha, always finite; NaN counts as 0, an alpha that is not finite as
        infinite.
        """
        alpha_px = max(abs(self.alpha_px), 1e-300) if math.isfinite(self.alpha_px) else math.inf
        steps = distance_px / alpha_px if math.isfinite(distance_px) else distance_px
        return 0.0 if math.isnan(steps) else min(max(steps, -_FAR), _FAR)

    def beyond(self, eyes_px: Eyes) -> bool:
        """Whether the midpoint of the eyes is so far out that motion hardly changes the picture:
        `place` clamps it where the outer eye leaves the grid.
        """
        left_u, left_v, right_u, right_v = eyes_px
        (cx, cy), (half_rows, half_cols) = self.centre_px, self._middle
        left, right = self._steps(cx - left_u), self._steps(cx - right_u)
        row = self._steps((left_v + right_v) / 2 - cy)
        room = max(half_cols - abs(left - right) / 2, 0.0)
        return abs(left + right) / 2 > room + self._reach / 2 or (
            self.rows > 1 and abs(row) > half_rows
        )

    def dragged(self, centre_px: tuple[float, float], eyes_px: Eyes) -> tuple[float, float]:
        """The neutral position nearest to centre_px that puts the eyes within the grid if
        they fit.
        """
        left_u, left_v, right_u, right_v = eyes_px
        alpha_px = min(abs(self.alpha_px), _FAR) if math.isfinite(self.alpha_px) else _FAR
        x, y, half_rows, half_cols = (left_u + right_u) / 2, (left_v + right_v) / 2, *self._middle
        room_x = max(half_cols * alpha_px - abs(left_u - right_u) / 2, 0.0)
        room_y = half_rows * alpha_px
        cx, cy = centre_px
        return min(max(cx, x - room_x), x + room_x), min(max(cy, y - room_y), y + room_y)

    def views(self, eyes_px: Eyes) -> tuple[Position, Position]:
        """Viewpoints ((row, col) left, (row, col) right) for the eyes, as `positions`."""
        return self.positions(self.place(eyes_px))

    def place(self, eyes_px: Eyes) -> Place:
        """The place of the eyes on the grid.

        Always finite and within the grid plus extrapolate_views. An eye that is NaN looks from the
        neutral view.
        """
        left_u, left_v, right_u, right_v = eyes_px
        (r0, c0), (cx, cy) = self._middle, self.centre_px
        # Halve first: the sum of two finite numbers may overflow. A single row has no vertical
        # parallax: ignore the height.
        row = limited(
            r0 + self._steps(left_v / 2 + right_v / 2 - cy),
            0.0,
            self.rows - 1.0,
            self._reach if self.rows > 1 else 0.0,
        )
        left, right = c0 + self._steps(cx - left_u), c0 + self._steps(cx - right_u)
        if self._render.keep_depth:
            return row, *pair_clamped(left, right, self.cols, self._reach)
        left, right = (limited(col, 0.0, self.cols - 1.0, self._reach) for col in (left, right))
        return row, left, right

    def positions(self, place: Place) -> tuple[Position, Position]:
        """Viewpoints ((row, col) left, (row, col) right) at a place: whole views in nearest mode,
        swapped if the configuration swaps the eyes.
        """
        row, left, right = place
        if self._snap:
            row, left, right = map(_snapped, place, self._whole)
            self._whole = row, left, right
        return (
            ((row, right), (row, left)) if self._render.swap_eyes else ((row, left), (row, right))
        )

    def eyes_at(self, place: Place) -> Eyes:
        """The eyes at a place, in px of the camera picture: the inverse of `place` in the grid."""
        row, left, right = place
        (r0, c0), (cx, cy) = self._middle, self.centre_px
        v = cy + (row - r0) * self.alpha_px
        return cx - (left - c0) * self.alpha_px, v, cx - (right - c0) * self.alpha_px, v


class ViewWeight(NamedTuple):
    """A stored view and its share of the picture."""

    row: int
    col: int
    weight: float


def cell_of(position: float, count: int) -> tuple[int, float]:
    """Lower index of the pair of views around position, and the share of the upper one; the
    outermost pair at the edge.
    """
    inside = min(max(position, 0.0), count - 1.0)
    low = min(int(inside), max(count - 2, 0))
    return low, inside - low


def _faded(share: float, half_width: float) -> float:
    return min(max((share - 0.5) / (2 * half_width) + 0.5, 0.0), 1.0)


def view_weights(method: str, position: Position, rows: int, cols: int) -> list[ViewWeight]:
    """The stored views that method uses at position, with weights > 0 that sum to 1 and are
    continuous in position for blend and warp2. position must be finite.

    warp2 fades only around the middle between views, where the nearest view changes; elsewhere it
    uses one view. Heads move sideways, so columns have the wider zone.
    """
    row, col = position
    if method in ("nearest", "warp"):
        r, c = math.floor(row + 0.5), math.floor(col + 0.5)
        return [ViewWeight(min(max(r, 0), rows - 1), min(max(c, 0), cols - 1), 1.0)]
    r, up = cell_of(row, rows)
    c, right = cell_of(col, cols)
    if method == "warp2":
        up, right = _faded(up, ROW_FADE), _faded(right, COL_FADE)
    shares = [
        (r, c, (1 - up) * (1 - right)),
        (r, c + 1, (1 - up) * right),
        (r + 1, c, up * (1 - right)),
        (r + 1, c + 1, up * right),
    ]
    spared = min(sorted(share[2] for share in shares)[1], SPARED_SHARE) if method == "warp2" else 0
    total = 1 - sum(min(share[2], spared) for share in shares)
    return [ViewWeight(r, c, (share - spared) / total) for r, c, share in shares if share > spared]


# The zero plane: the disparity in the plane of the screen.

# zero planes to offer, from the farthest to the nearest point of a scene; the smallest step
PLANES, MIN_STEP_PX = 40, 0.01
UNKNOWN_PX = (-2.0, 2.0)  # disparities if they are unknown, or all equal


def zero_plane_px(field: LightField, render: Render) -> float:
    """render.zero_plane_px as a number, px per view."""
    return field.border_px[1] if isinstance(render.zero_plane_px, str) else render.zero_plane_px


def zero_planes_px(low_px: float, high_px: float) -> tuple[float, float, float]:
    """(minimum, maximum, step) of the zero planes to offer: the disparities of a scene, low_px to
    high_px, and half their range beyond either end.
    """
    low_px, high_px = (low_px, high_px) if high_px > low_px else UNKNOWN_PX
    step_px = float(f"{max((high_px - low_px) / PLANES, MIN_STEP_PX):.0g}")
    margin_px = max((high_px - low_px) / 2, 10 * MIN_STEP_PX)
    return low_px - margin_px, high_px + margin_px, step_px
