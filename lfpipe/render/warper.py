"""The position in a stored view of each pixel of a new picture, and whether that view sees it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.blocks import MARGIN, bands_of, places, size_of
from lfpipe.render.view_weights import Position, ViewWeight, cell_of
from lfpipe.scene.lightfield import UNKNOWN, LightField

CAREFUL_PX = 1.0  # separation of near and far above which hidden parts are handled, at a seventh of the cost of a warp
# Remaining weight of a view that does not see the point, and the distance in px at which that is certain. The test fails along
# every edge, so it is too uncertain to drop a view altogether.
UNSEEN, UNSEEN_PX = 0.35, 1.5
SOFT = 5  # values of disparity over which a cross-fade ramps up
OUTSIDE = 16  # a view's weight is divided by this if the point lies outside it


class Warper:
    """Sampling maps from the disparity of a light field; owns its buffers, so a call allocates nothing."""

    def __init__(self, field: LightField) -> None:
        if field.disparity is None:
            raise ValueError("a light field without disparity cannot be warped")
        self._stored = np.asarray(field.disparity)
        self._offsets = field.offsets.astype(np.float64)
        self._unit_px = float(field.disparity_scale_px)
        self._span_px = field.disparity_max_px - field.disparity_min_px
        same = self._stored.shape[3:] == size_of(field.height_px, field.width_px)
        self._bands = bands_of(self._stored.shape[3], 16 * self._stored.shape[4]) if same else [slice(0, self._stored.shape[3])]
        self._known: dict[tuple[int, int, int], bool] = {}  # of the maps examined, those without UNKNOWN
        self._known_cells: dict[tuple[int, int, int], bool] = {}
        self._size = field.width_px, field.height_px
        self._most_px = max(abs(field.disparity_min_px), abs(field.disparity_max_px))
        self._last = field.height_px + MARGIN - 2, field.width_px + MARGIN - 2  # places of the last whole block (y, x)
        self._reach = 0  # blocks from the border that the last maps can lead outside
        low = self._stored.shape[3:]
        self._step = (field.height_px / low[0], field.width_px / low[1])  # px of a view per px of its disparity
        self._low, self._landed, self._again = (np.empty(low, np.float32) for _ in range(3))
        self._read = self._stored[0, 0, 0]  # the source of the last maps
        self._low_there = np.empty(low, np.float32), np.empty(low, np.float32)
        self._bytes = np.empty((2, *low), np.uint8)
        y, x = np.mgrid[0 : low[0], 0 : low[1]].astype(np.float32)
        self._low_at = np.ascontiguousarray(x), np.ascontiguousarray(y)
        self._at_x, self._at_y = places(field.height_px, field.width_px)
        self._each, self._x, self._y = (np.empty(self._at_x.shape, np.float32) for _ in range(3))
        self._weights = np.empty(self._at_x.shape, np.uint8)
        self._found = self._at_x, self._at_y  # the last maps
        self._move = (0.0, 0.0), (0.0, 0.0)  # of the last maps, along x and y: px of the disparity per stored unit, and in all
        self._unsure = 0.0  # stored units of disparity that move a pixel by UNSEEN_PX; 0 if everything is seen

    def offset(self, view: ViewWeight, position: Position) -> Position:
        """Steps from the view's camera to position. Cameras off the regular grid bend the coordinates: whole numbers are always
        the cameras themselves, and offsets between them are interpolated."""
        rows, cols = self._offsets.shape[:2]
        r, up = cell_of(position[0], rows)
        c, right = cell_of(position[1], cols)
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
        stored, known = self._map(frame, view)
        self._read = stored
        np.copyto(self._low, stored)
        if not known:
            self._low[stored == UNKNOWN] = 0
        per_x, per_y = right * self._unit_px, down * self._unit_px
        self._reach = math.ceil((self._most_px * max(abs(right), abs(down)) + max(abs(shift_x), abs(shift_y))) / 2) + 1
        self._found = self._x, self._y if per_y or shift_y else self._at_y
        moves = ((per_x, shift_x, self._at_x, self._x), (per_y, shift_y, self._at_y, self._found[1]))
        self._prepare(down, right, shift_px)
        same = self._low.shape == self._each.shape
        for band in self._bands:
            each = self._landing(band)
            if not same:
                cv2.resize(each, self._each.shape[::-1], self._each, interpolation=cv2.INTER_LINEAR)
                each = self._each
            rows = band if same else slice(None)
            for per_unit, shift, start, out in moves:
                if out is not start:
                    part = cv2.scaleAdd(each, per_unit, start[rows], out[rows])
                    if shift:
                        np.add(part, shift, out=part)
        return self._found

    def _map(self, frame: int, view: ViewWeight) -> tuple[NDArray[np.int8], bool]:
        """The stored disparity of a view, and whether it is known everywhere."""
        place = min(frame, len(self._stored) - 1), view.row, view.col
        stored: NDArray[np.int8] = self._stored[place]
        if place not in self._known:
            self._known[place] = bool(stored.min() > UNKNOWN)
        return stored, self._known[place]

    def known_around(self, frame: int, position: Position) -> bool:
        """Whether the disparity of the four views around position is known everywhere."""
        rows, cols = self._offsets.shape[:2]
        cell = frame, cell_of(position[0], rows)[0], cell_of(position[1], cols)[0]
        known = self._known_cells.get(cell)
        if known is None:
            corners = ((min(cell[1] + down, rows - 1), min(cell[2] + right, cols - 1)) for down in (0, 1) for right in (0, 1))
            known = self._known_cells[cell] = all(self._map(frame, ViewWeight(*at, 1.0))[1] for at in corners)
        return known

    def unknown(self, frame: int, views: Sequence[ViewWeight]) -> NDArray[np.float32]:
        """Share of the cross-fade at each pixel, because disparity is unknown: float32 (height, width), 0 to 1."""
        maps = [(view, self._map(frame, view)[0]) for view in views]
        faded = sum((view.weight * (stored == UNKNOWN) for view, stored in maps), np.zeros(1))
        most = np.clip(2 * np.asarray(faded, np.float32) - 1, 0, 1)  # other views know it
        soft = cv2.blur(most, (SOFT, SOFT))
        return np.asarray(cv2.resize(soft, self._size, interpolation=cv2.INTER_LINEAR), np.float32)

    def weights(self, share: float) -> NDArray[np.uint8]:
        """Weight of the view of the last `maps` at each block, uint8 (rows, columns), at most 255 * share, less if it does not
        see the point. Valid until the next call.

        If the view sees the point, the disparity leads to a place of that same disparity; if something hides the point, to a
        different one.
        """
        full = 255 * share
        if not self._unsure:
            self._weights.fill(round(full))
            return self._without_outside()
        off = self._look_up(slice(None), self._again, self._landed)
        cv2.absdiff(off, self._again, off)
        np.minimum(off, np.float32(self._unsure), out=off)
        weights = self._weights if off.shape == self._weights.shape else self._bytes[0]
        cv2.convertScaleAbs(off, weights, -full * (1 - UNSEEN) / self._unsure, full)
        if weights is not self._weights:
            cv2.resize(weights, self._weights.shape[::-1], self._weights, interpolation=cv2.INTER_LINEAR)
        return self._without_outside()

    def _without_outside(self) -> NDArray[np.uint8]:
        """The weights, almost 0 for places outside the view, which repeat its border."""
        x, y = self._found
        for at, last, weights in ((x, self._last[1], self._weights), (y.T, self._last[0], self._weights.T)):
            middle = at.shape[1] // 2
            strip = min(self._reach, middle)
            for part in (np.s_[:, :strip], np.s_[:, max(at.shape[1] - self._reach, middle) :]):
                outside = (at[part] < MARGIN) | (at[part] > last)
                if outside.any():
                    weights[part] = np.where(outside, np.maximum(weights[part] // OUTSIDE, 1), weights[part])
        return self._weights

    def _prepare(self, down: float, right: float, shift_px: Position) -> None:
        """Prepares `_landing`: how far pixels move, and the nearest object in reach of each."""
        per_px = self._unit_px / self._step[1], self._unit_px / self._step[0]
        self._move = (right * per_px[0], shift_px[1] / self._step[1]), (down * per_px[1], shift_px[0] / self._step[0])
        apart_x, apart_y = abs(right) * self._span_px, abs(down) * self._span_px
        self._unsure = 0.0
        if max(apart_x, apart_y) < CAREFUL_PX:
            return
        self._unsure = UNSEEN_PX / (max(abs(down), abs(right)) * self._unit_px)
        reach = (math.ceil(apart_y / self._step[0]), math.ceil(apart_x / self._step[1]))
        rows, cols = len(self._low), len(self._low[0])
        steps, nearest = self._bytes  # a register holds four times as many bytes as floats
        np.bitwise_xor(self._read.view(np.uint8), np.uint8(128), out=steps)
        cv2.dilate(steps, _box(min(reach[0], rows), min(reach[1], cols)), nearest)

    def _landing(self, band: slice) -> NDArray[np.float32]:
        """The view's disparity, in stored units, at the place where each pixel of a band lands: d(x + d * steps).

        One iteration of the fixed point from d(x) suffices if little is hidden. If near and far separate by more than CAREFUL_PX,
        the search starts from the nearest object in reach, so that the front object wins. A point hidden in the view does not
        converge: it alternates between the front object and the background. The nearer value then samples the background right
        beside the object.
        """
        landed, again = self._landed[band], self._again[band]
        if not self._unsure:
            return self._look_up(band, self._low[band], landed)
        start = np.subtract(self._bytes[1][band], np.float32(128.0), out=again)
        first = self._look_up(band, start, landed)
        second = self._look_up(band, first, again)
        cv2.max(first, second, second)
        return second

    def _look_up(self, band: slice, at: NDArray[np.float32], out: NDArray[np.float32]) -> NDArray[np.float32]:
        """The stored disparity at the place where each pixel of a band lands if its own is `at`. The nearest value: a mean of two
        would be neither."""
        places = [start[band] for start in self._low_at]
        for k, (per_unit, shift) in enumerate(self._move):
            if per_unit or shift:
                there = cv2.scaleAdd(at, per_unit, places[k], self._low_there[k][: len(at)])
                places[k] = np.add(there, shift, out=there) if shift else there  # cv2.add takes 4x1 arrays for scalars
        cv2.remap(self._low, places[0], places[1], cv2.INTER_NEAREST, out, borderMode=cv2.BORDER_REPLICATE)
        return out


@lru_cache(maxsize=256)
def _box(down: int, right: int) -> NDArray[np.uint8]:
    return np.ones((2 * down + 1, 2 * right + 1), np.uint8)
