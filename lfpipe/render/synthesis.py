"""Views between, and a little beyond, the stored views.

A viewpoint is (row, col), fractional, in grid steps; whole numbers are the stored views, which every method returns bit
for bit. Between them a stored view b is warped backwards along its own disparity d (px per grid step, nearer is positive):

    picture(x, y) = view_b(x + d * (col - b_col), y + d * (row - b_row)),   d taken where it lands (fixed point)

All of it runs on single planes at the light field's resolution, in blocks of 2x2 pixels, with disparity refined at its own lower
resolution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config.quality import WARPS
from lfpipe.render.blocks import Blocks, places, size_of
from lfpipe.scene.lightfield import LightField

Position = tuple[float, float]
Source = Callable[[int, int], NDArray[np.uint8]]  # a plane of the stored view (row, col)

CAREFUL_PX = 1.0  # parting of near and far from which hidden parts are looked after, a seventh of the cost of a warp
# Half the width, in views, of the zone in which warp2 fades from one stored view to the next. Against fading all the way
# (antinous): nothing lost with every 2nd view kept, 0.3 dB with every 4th, largest over median step of a sweep 2.1 instead of
# 2.0, and half as many views to warp on average.
ROW_FADE, COL_FADE = 0.1, 0.25


@attrs.frozen
class ViewWeight:
    """A stored view and its share of the picture."""

    row: int
    col: int
    weight: float


def _cell(position: float, count: int) -> tuple[int, float]:
    """Lower index of the pair of views around position, and the share of the upper one; at the rim the outermost pair."""
    inside = min(max(position, 0.0), count - 1.0)
    low = min(int(inside), max(count - 2, 0))
    return low, inside - low


def _nearest(position: float, count: int) -> int:
    return min(max(math.floor(position + 0.5), 0), count - 1)


def _faded(share: float, half_width: float) -> float:
    return min(max((share - 0.5) / (2 * half_width) + 0.5, 0.0), 1.0)


def view_weights(method: str, position: Position, rows: int, cols: int) -> list[ViewWeight]:
    """The stored views that method uses at position, with weights > 0 that sum to 1 and are continuous in position for
    blend and warp2. position must be finite.

    warp2 fades only around the middle between views, where the nearest view changes: elsewhere one view does. Heads move
    sideways, so columns have the wider zone.
    """
    row, col = position
    if method in ("nearest", "warp"):
        return [ViewWeight(_nearest(row, rows), _nearest(col, cols), 1.0)]
    r, up = _cell(row, rows)
    c, right = _cell(col, cols)
    if method == "warp2":
        up, right = _faded(up, ROW_FADE), _faded(right, COL_FADE)
    shares = [
        (r, c, (1 - up) * (1 - right)),
        (r, c + 1, (1 - up) * right),
        (r + 1, c, up * (1 - right)),
        (r + 1, c + 1, up * right),
    ]
    return [ViewWeight(*share) for share in shares if share[2] > 0]


def shifted(plane: NDArray[np.uint8], dy: int, dx: int, out: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """out[y, x] = plane[y + dy, x + dx], its border repeated outwards. Returns out."""
    height, width = plane.shape
    dy, dx = min(max(dy, 1 - height), height - 1), min(max(dx, 1 - width), width - 1)
    y0, y1, x0, x1 = max(0, -dy), min(height, height - dy), max(0, -dx), min(width, width - dx)
    out[y0:y1, x0:x1] = plane[y0 + dy : y1 + dy, x0 + dx : x1 + dx]
    out[y0:y1, :x0] = out[y0:y1, x0 : x0 + 1]
    out[y0:y1, x1:] = out[y0:y1, x1 - 1 : x1]
    out[:y0] = out[y0]
    out[y1:] = out[y1 - 1]
    return out


class Warper:
    """Sampling maps from the disparity of a light field; owns its buffers, so a call allocates nothing."""

    def __init__(self, field: LightField) -> None:
        if field.disparity is None:
            raise ValueError("a light field without disparity cannot be warped")
        self._stored = np.asarray(field.disparity)
        self._offsets = field.offsets.astype(np.float64)
        self._unit_px = float(field.disparity_scale_px)
        self._span_px = field.disparity_max_px - field.disparity_min_px
        low = self._stored.shape[3:]
        self._step = (field.height_px / low[0], field.width_px / low[1])  # px of a view per px of its disparity
        self._low, self._landed, self._again, self._low_x, self._low_y = (np.empty(low, np.float32) for _ in range(5))
        self._low_at_y, self._low_at_x = (np.ascontiguousarray(a, np.float32) for a in np.mgrid[0 : low[0], 0 : low[1]])
        self._at_x, self._at_y = places(field.height_px, field.width_px)
        self._each, self._x, self._y = (np.empty(self._at_x.shape, np.float32) for _ in range(3))

    def offset(self, view: ViewWeight, position: Position) -> Position:
        """Steps from the view's camera to position. Cameras that stand off the regular grid bend the coordinates: whole
        numbers are always the cameras themselves, and between them the offsets are interpolated."""
        rows, cols = self._offsets.shape[:2]
        r, up = _cell(position[0], rows)
        c, right = _cell(position[1], cols)
        r1, c1 = min(r + 1, rows - 1), min(c + 1, cols - 1)
        near, far = self._offsets[r], self._offsets[r1]
        bend = (1 - up) * ((1 - right) * near[c] + right * near[c1]) + up * ((1 - right) * far[c] + right * far[c1])
        bend -= self._offsets[view.row, view.col]
        return position[0] - view.row + float(bend[0]), position[1] - view.col + float(bend[1])

    def maps(
        self, frame: int, view: ViewWeight, steps: Position, shift_px: Position
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Maps (x, y), float32 (rows, columns) of blocks, that sample the view as seen steps away from it, moved by
        shift_px. steps, shift_px: (row, col). The maps are for `Blocks.sample` and valid until the next call.
        """
        down, right = steps
        shift_y, shift_x = shift_px
        np.copyto(self._low, self._stored[min(frame, len(self._stored) - 1), view.row, view.col])
        per_x, per_y = right * self._unit_px, down * self._unit_px
        each = self._landing(down, right, shift_px)
        if each.shape != self._each.shape:
            cv2.resize(each, self._each.shape[::-1], self._each, interpolation=cv2.INTER_LINEAR)
            each = self._each
        cv2.scaleAdd(each, per_x, self._at_x, self._x)
        if shift_x:
            np.add(self._x, shift_x, out=self._x)
        if not per_y and not shift_y:
            return self._x, self._at_y
        cv2.scaleAdd(each, per_y, self._at_y, self._y)
        if shift_y:
            np.add(self._y, shift_y, out=self._y)
        return self._x, self._y

    def _landing(self, down: float, right: float, shift_px: Position) -> NDArray[np.float32]:
        """The view's disparity, in stored units, at the place where each pixel of the new picture lands: d(x + d * steps).

        One round of the fixed point from d(x) does where little is hidden. Where near and far part by more than
        CAREFUL_PX, the search starts from the nearest thing in reach, so that what is in front wins. What was hidden in the
        view never settles but jumps between the thing in front and what is behind it: the nearer value then samples the
        background right beside the thing.
        """
        apart_x, apart_y = abs(right) * self._span_px, abs(down) * self._span_px
        if max(apart_x, apart_y) < CAREFUL_PX:
            return self._look_up(self._low, down, right, shift_px, self._landed)
        reach = (math.ceil(apart_y / self._step[0]), math.ceil(apart_x / self._step[1]))
        rows, cols = len(self._low), len(self._low[0])
        start = self._again
        cv2.dilate(self._low, _box(min(reach[0], rows), min(reach[1], cols)), start)
        first = self._look_up(start, down, right, shift_px, self._landed)
        second = self._look_up(first, down, right, shift_px, self._again)
        cv2.max(first, second, second)
        return second

    def _look_up(
        self, at: NDArray[np.float32], down: float, right: float, shift_px: Position, out: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The stored disparity where each pixel lands if its own is `at`. The nearest value: between two is neither."""
        cv2.scaleAdd(at, right * self._unit_px / self._step[1], self._low_at_x, self._low_x)
        cv2.scaleAdd(at, down * self._unit_px / self._step[0], self._low_at_y, self._low_y)
        if any(shift_px):
            np.add(self._low_x, shift_px[1] / self._step[1], out=self._low_x)  # cv2.add takes 4x1 arrays for scalars
            np.add(self._low_y, shift_px[0] / self._step[0], out=self._low_y)
        cv2.remap(self._low, self._low_x, self._low_y, cv2.INTER_NEAREST, out, borderMode=cv2.BORDER_REPLICATE)
        return out


@lru_cache(maxsize=256)
def _box(down: int, right: int) -> NDArray[np.uint8]:
    return np.ones((2 * down + 1, 2 * right + 1), np.uint8)


class Synthesiser:
    """Planes of a light field from any viewpoint."""

    def __init__(self, field: LightField, method: str) -> None:
        self.method = method
        self._rows, self._cols = field.rows, field.cols
        self._centre = ((field.rows - 1) / 2, (field.cols - 1) / 2)
        self._warper = Warper(field) if method in WARPS else None
        size = (field.height_px, field.width_px)
        self._parts = [np.empty(size, np.uint8) for _ in range(4)]
        self._blocks = Blocks(*size)
        self._made = [np.empty((*size_of(*size), 4), np.uint8) for _ in range(5)]

    def render(
        self, position: Position, frame: int, zero_plane_px: float, sources: Sequence[Source], outs: Sequence[NDArray[np.uint8]]
    ) -> list[NDArray[np.uint8]]:
        """One plane for each source, at most four, seen from position.

        zero_plane_px: disparity that is to lie in the plane of the screen. outs: uint8 (height, width) each, to draw into.
        Returns the planes: an element of outs, or the stored plane itself where that is the picture.
        """
        used = view_weights(self.method, position, self._rows, self._cols)
        if self._warper is None:
            return self._faded(used, zero_plane_px, sources, outs)
        return self._warped(self._warper, used, position, frame, zero_plane_px, sources, outs)

    def _faded(
        self, used: list[ViewWeight], zero_plane_px: float, sources: Sequence[Source], outs: Sequence[NDArray[np.uint8]]
    ) -> list[NDArray[np.uint8]]:
        """The stored views one over the other, each as a whole moved to where its zero plane belongs."""
        made: list[NDArray[np.uint8]] = []
        total = 0.0
        for view in used:
            total += view.weight
            dy, dx = (round(zero_plane_px * (c - p)) for c, p in zip(self._centre, (view.row, view.col), strict=True))
            part = [source(view.row, view.col) for source in sources]
            if dy or dx:
                into = self._parts if made else outs
                part = [shifted(plane, dy, dx, to) for plane, to in zip(part, into, strict=False)]
            if made:
                for k, plane in enumerate(part):
                    cv2.addWeighted(plane, view.weight / total, made[k], 1 - view.weight / total, 0.0, outs[k])
                made = list(outs[: len(part)])
            else:
                made = part
        return made

    def _warped(
        self,
        warper: Warper,
        used: list[ViewWeight],
        position: Position,
        frame: int,
        zero_plane_px: float,
        sources: Sequence[Source],
        outs: Sequence[NDArray[np.uint8]],
    ) -> list[NDArray[np.uint8]]:
        """Each view along its own disparity, then one over the other, all in blocks until the end."""
        shift = (zero_plane_px * (self._centre[0] - position[0]), zero_plane_px * (self._centre[1] - position[1]))
        total = 0.0
        for view in used:
            steps = warper.offset(view, position)
            if steps == (0.0, 0.0) and not any(shift):
                return [source(view.row, view.col) for source in sources]
            x, y = warper.maps(frame, view, steps, shift)
            share = view.weight / (total + view.weight)
            for source, blocks in zip(sources, self._made, strict=False):
                part = blocks if share == 1 else self._made[-1]
                self._blocks.sample(source(view.row, view.col), x, y, part)
                if part is not blocks:
                    cv2.addWeighted(part, share, blocks, 1 - share, 0.0, blocks)
            total += view.weight
        drawn = list(outs[: len(sources)])
        for blocks, out in zip(self._made, drawn, strict=False):
            self._blocks.pixels(blocks, out)
        return drawn
