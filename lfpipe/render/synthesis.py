"""Views between, and a little beyond, the stored views.

A viewpoint is (row, col), fractional, in grid steps; whole numbers are the stored views, which every method returns bit
for bit. Between them a stored view b is warped backwards along its own disparity d (px per grid step, nearer is positive):

    picture(x, y) = view_b(x + d * (col - b_col), y + d * (row - b_row)),   d taken where it lands (fixed point)

All of it runs on single planes at the light field's resolution, with disparity refined at its own lower resolution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.lightfield import LightField

Position = tuple[float, float]
Source = Callable[[int, int], NDArray[np.uint8]]  # a plane of the stored view (row, col)

ROW_FADE = 0.25  # half the width, in rows, of the zone where warp2 fades from one row of views to the next


@attrs.frozen
class Tap:
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


def taps(method: str, position: Position, rows: int, cols: int) -> list[Tap]:
    """The stored views that method uses at position, with weights > 0 that sum to 1 and are continuous in position for
    blend and warp2. position must be finite.

    warp2 crosses columns over the whole step, as heads move sideways, and rows in a zone half as wide: two views do
    where four would bring little.
    """
    row, col = position
    if method in ("nearest", "warp"):
        return [Tap(_nearest(row, rows), _nearest(col, cols), 1.0)]
    r, up = _cell(row, rows)
    c, right = _cell(col, cols)
    if method == "warp2":
        up = min(max((up - 0.5) / (2 * ROW_FADE) + 0.5, 0.0), 1.0)
    shares = [
        (r, c, (1 - up) * (1 - right)),
        (r, c + 1, (1 - up) * right),
        (r + 1, c, up * (1 - right)),
        (r + 1, c + 1, up * right),
    ]
    return [Tap(*share) for share in shares if share[2] > 0]


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
        self._extent_px = max(abs(field.disparity_min_px), abs(field.disparity_max_px))
        low, size = self._stored.shape[3:], (field.height_px, field.width_px)
        self._step = (size[0] / low[0], size[1] / low[1])  # px of a view per px of its disparity
        self._bytes = np.empty(low, np.float32)
        self._low, self._landed, self._low_x, self._low_y = (np.empty(low, np.float32) for _ in range(4))
        self._full, self._x, self._y = (np.empty(size, np.float32) for _ in range(3))
        self._at_y, self._at_x = (np.ascontiguousarray(a, np.float32) for a in np.mgrid[0 : size[0], 0 : size[1]])
        self._low_at_y, self._low_at_x = (np.ascontiguousarray(a, np.float32) for a in np.mgrid[0 : low[0], 0 : low[1]])

    def offset(self, tap: Tap, position: Position) -> Position:
        """Steps from the tap's camera to position. Cameras that stand off the regular grid bend the coordinates: whole
        numbers are always the cameras themselves, and between them the offsets are interpolated."""
        rows, cols = self._offsets.shape[:2]
        r, up = _cell(position[0], rows)
        c, right = _cell(position[1], cols)
        r1, c1 = min(r + 1, rows - 1), min(c + 1, cols - 1)
        near, far = self._offsets[r], self._offsets[r1]
        bend = (1 - up) * ((1 - right) * near[c] + right * near[c1]) + up * ((1 - right) * far[c] + right * far[c1])
        bend -= self._offsets[tap.row, tap.col]
        return position[0] - tap.row + float(bend[0]), position[1] - tap.col + float(bend[1])

    def maps(self, frame: int, tap: Tap, steps: Position, shift_px: Position) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Maps (x, y), float32 (height, width), that sample the tap's view as seen steps away from it, moved by shift_px.

        steps, shift_px: (row, col). The maps are valid until the next call.
        """
        down, right = steps
        shift_y, shift_x = shift_px
        np.copyto(self._bytes, self._stored[min(frame, len(self._stored) - 1), tap.row, tap.col])
        cv2.multiply(self._bytes, self._unit_px, self._low)
        landed = self._low
        reach_px = max(abs(down), abs(right)) * self._extent_px
        for _ in range(self._rounds(reach_px)):
            cv2.scaleAdd(landed, right / self._step[1], self._low_at_x, self._low_x)
            cv2.scaleAdd(landed, down / self._step[0], self._low_at_y, self._low_y)
            if shift_x or shift_y:
                cv2.add(self._low_x, shift_x / self._step[1], self._low_x)
                cv2.add(self._low_y, shift_y / self._step[0], self._low_y)
            landed = cv2.remap(
                self._low, self._low_x, self._low_y, cv2.INTER_LINEAR, self._landed, borderMode=cv2.BORDER_REPLICATE
            )
        if landed.shape == self._full.shape:
            full = landed
        else:
            full = cv2.resize(landed, self._full.shape[::-1], self._full, interpolation=cv2.INTER_LINEAR)
        cv2.scaleAdd(full, right, self._at_x, self._x)
        cv2.scaleAdd(full, down, self._at_y, self._y)
        if shift_x or shift_y:
            cv2.add(self._x, shift_x, self._x)
            cv2.add(self._y, shift_y, self._y)
        return self._x, self._y

    def _rounds(self, reach_px: float) -> int:
        """Rounds of the fixed point that pay for the distance content moves."""
        return 1 if reach_px < 4 else 2


class Synthesiser:
    """Planes of a light field from any viewpoint."""

    def __init__(self, field: LightField, method: str) -> None:
        self.method = method
        self._rows, self._cols = field.rows, field.cols
        self._centre = ((field.rows - 1) / 2, (field.cols - 1) / 2)
        self._warper = Warper(field) if method in ("warp", "warp2") else None
        self._one, self._two = (np.empty((field.height_px, field.width_px), np.uint8) for _ in range(2))

    def render(
        self, position: Position, frame: int, zero_plane_px: float, sources: Sequence[Source], outs: Sequence[NDArray[np.uint8]]
    ) -> list[NDArray[np.uint8]]:
        """One plane for each source, seen from position.

        zero_plane_px: disparity that is to lie in the plane of the screen. outs: uint8 (height, width) each, to draw into.
        Returns the planes: an element of outs, or the stored plane itself where that is the picture.
        """
        made: list[NDArray[np.uint8]] = list(outs)
        total = 0.0
        for tap in taps(self.method, position, self._rows, self._cols):
            total += tap.weight
            share = tap.weight / total
            draw = self._drawer(tap, position, frame, zero_plane_px)
            for k, source in enumerate(sources):
                first = share == 1.0
                plane = draw(source(tap.row, tap.col), outs[k] if first else self._one)
                made[k] = plane if first else cv2.addWeighted(plane, share, made[k], 1 - share, 0.0, outs[k])
        return made

    def _drawer(
        self, tap: Tap, position: Position, frame: int, zero_plane_px: float
    ) -> Callable[[NDArray[np.uint8], NDArray[np.uint8]], NDArray[np.uint8]]:
        """How a plane of the tap's view becomes its part of the picture: (plane, out) -> plane itself or out."""
        if self._warper is None:
            dy, dx = (round(zero_plane_px * (c - p)) for c, p in zip(self._centre, (tap.row, tap.col), strict=True))
            return (lambda plane, out: shifted(plane, dy, dx, out)) if dy or dx else (lambda plane, out: plane)
        steps = self._warper.offset(tap, position)
        shift = (zero_plane_px * (self._centre[0] - position[0]), zero_plane_px * (self._centre[1] - position[1]))
        if steps == (0.0, 0.0) and not any(shift):
            return lambda plane, out: plane
        x, y = self._warper.maps(frame, tap, steps, shift)
        return lambda plane, out: cv2.remap(plane, x, y, cv2.INTER_LINEAR, out, borderMode=cv2.BORDER_REPLICATE)
