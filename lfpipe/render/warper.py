"""The position in a stored view of each pixel of a new picture, and whether that view sees it."""

import itertools
import math
from functools import lru_cache

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.blocks import Box, bands_of, places, shifted, size_of
from lfpipe.render.viewpoint import Position, ViewWeight, cell_of, view_weights
from lfpipe.scene.lightfield import UNKNOWN, LightField

CAREFUL_PX = 1.0  # separation of near and far above which hidden parts are handled, at a seventh of the cost of a warp
SOFT = 5  # values of disparity over which a cross-fade ramps up


Moves = tuple[
    tuple[float, float], tuple[float, float]
]  # along x and y: px per stored unit of disparity, and px in all
Pair = tuple[NDArray[np.float32], NDArray[np.float32]]  # x, y


@attrs.frozen(eq=False)
class Band:
    """Rows of blocks processed at a time, with their parts of the arrays of a Warper.

    low: the disparity, in stored units. nearest: of `Warper.aim`. index: x and y of each disparity. place: x and y of each block.
    moved: x and y after a displacement. first, second: disparities.
    """

    rows: slice
    low: NDArray[np.float32]
    nearest: NDArray[np.uint8]
    index: Pair
    place: Pair
    moved: Pair
    first: NDArray[np.float32]
    second: NDArray[np.float32]


class Warper:
    """Sampling maps from the disparity of a light field; owns its buffers, so a call allocates nothing."""

    def __init__(self, field: LightField) -> None:
        if field.disparity is None:
            raise ValueError("a light field without disparity cannot be warped")
        self._stored = np.asarray(field.disparity)
        self._offsets = field.offsets.astype(np.float64)
        self._regular = not self._offsets.any()
        self._unit_px, self._turned = (
            abs(float(field.disparity_scale_px)),
            field.disparity_scale_px < 0,
        )
        self._span_px = field.disparity_max_px - field.disparity_min_px
        rows, cols = size_of(field.height_px, field.width_px)
        if self._stored.shape[3:] != (rows, cols):
            raise ValueError(
                f"disparity of {self._stored.shape[3:]} values, not one for each 2x2 pixels: {rows, cols}"
            )
        self._unknown: dict[tuple[int, int, int], Box | None] = {}  # of the maps examined
        self._unknown_cells: dict[tuple[int, int, int], Box | None] = {}
        self._size = field.width_px, field.height_px
        self._step = (
            field.height_px / rows,
            field.width_px / cols,
        )  # px of a view per px of its disparity
        self._low = np.empty((rows, cols), np.float32)
        self._bytes = np.empty((2, rows, cols), np.uint8)
        y, x = (np.ascontiguousarray(axis, np.float32) for axis in np.mgrid[:rows, :cols])
        place_x, place_y = places(field.height_px, field.width_px)
        bands = bands_of(rows, 16 * cols)
        scratch = np.empty((4, bands[0].stop, cols), np.float32)
        self.bands = []
        for band in bands:
            first, second, moved_x, moved_y = scratch[:, : band.stop - band.start]
            low, nearest = self._low[band], self._bytes[1][band]
            index, place = (x[band], y[band]), (place_x[band], place_y[band])
            self.bands.append(
                Band(band, low, nearest, index, place, (moved_x, moved_y), first, second)
            )
        self.most_px = 0.0
        self._moves = self._low_moves = (
            (0.0, 0.0),
            (0.0, 0.0),
        )  # in px of the view, and of its disparity
        self._careful = False  # whether near and far separate enough to hide each other

    def offset(self, view: ViewWeight, position: Position) -> Position:
        """Steps from the view's camera to position. Cameras off the regular grid bend the coordinates: whole numbers are always
        the cameras themselves, and offsets between them are interpolated."""
        if self._regular:
            return position[0] - view.row, position[1] - view.col
        rows, cols = self._offsets.shape[:2]
        r, up = cell_of(position[0], rows)
        c, right = cell_of(position[1], cols)
        r1, c1 = min(r + 1, rows - 1), min(c + 1, cols - 1)
        near, far = self._offsets[r], self._offsets[r1]
        bend = (1 - up) * ((1 - right) * near[c] + right * near[c1]) + up * (
            (1 - right) * far[c] + right * far[c1]
        )
        bend -= self._offsets[view.row, view.col]
        return position[0] - view.row + float(bend[0]), position[1] - view.col + float(bend[1])

    def aim(self, frame: int, view: ViewWeight, steps: Position, shift_px: Position) -> None:
        """Prepare `maps` of the view as seen steps away from it, moved by shift_px. steps, shift_px: (row, col)."""
        down, right = steps
        shift_y, shift_x = shift_px
        stored, unknown = self._map(frame, view.row, view.col)
        if self._turned:  # near and far are exchanged
            np.negative(stored, out=self._low, dtype=np.float32)
        else:
            np.copyto(self._low, stored)
        if unknown is not None:
            self._low[unknown][stored[unknown] == UNKNOWN] = 0
        self._moves = (right * self._unit_px, shift_x), (down * self._unit_px, shift_y)
        self.most_px = 128 * self._unit_px * abs(down) + abs(
            shift_y
        )  # by which a pixel is moved down or up at most
        per_px = self._unit_px / self._step[1], self._unit_px / self._step[0]
        self._low_moves = (
            (right * per_px[0], shift_x / self._step[1]),
            (down * per_px[1], shift_y / self._step[0]),
        )
        apart_x, apart_y = abs(right) * self._span_px, abs(down) * self._span_px
        self._careful = max(apart_x, apart_y) >= CAREFUL_PX
        if not self._careful:
            return
        reach = (math.ceil(apart_y / self._step[0]), math.ceil(apart_x / self._step[1]))
        rows, cols = self._low.shape
        steps_up, nearest = self._bytes  # a register holds four times as many bytes as floats
        np.bitwise_xor(stored.view(np.uint8), np.uint8(128), out=steps_up)
        if self._turned:
            np.negative(steps_up, out=steps_up)  # 1 to 255 in reverse; 0, unknown, stays
        cv2.dilate(steps_up, _box(min(reach[0], rows), min(reach[1], cols)), nearest)

    def maps(self, band: Band) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Maps (x, y), float32 (rows of band, columns) of blocks, that sample the view of `aim`. band: one of `bands`. The maps
        are for `Blocks.sample`, not to be written to, and valid until the next call.

        They follow the view's disparity at the place where each pixel lands: d(x + d * steps). One iteration of the fixed point
        from d(x) suffices if little is hidden. If near and far separate by more than CAREFUL_PX, the search starts from the
        nearest object in reach, so that the front object wins. A point hidden in the view does not converge: it alternates
        between the front object and the background. The nearer value then samples the background right beside the object.
        """
        if self._careful:
            start = np.subtract(band.nearest, np.float32(128.0), out=band.second)
            first = self._look_up(band, start, band.first)
            disparity = self._look_up(band, first, band.second)
            cv2.max(first, disparity, disparity)
        else:
            disparity = self._look_up(band, band.low, band.first)
        return _moved(disparity, self._moves, band.place, band.moved)

    def _map(self, frame: int, row: int, col: int) -> tuple[NDArray[np.int8], Box | None]:
        """The stored disparity of a view, and the box that holds what is unknown in it; None if it is known everywhere."""
        place = min(frame, len(self._stored) - 1), row, col
        stored: NDArray[np.int8] = self._stored[place]
        if place not in self._unknown:
            x, y, width, height = (
                cv2.boundingRect((stored == UNKNOWN).astype(np.uint8))
                if stored.min() == UNKNOWN
                else (0,) * 4
            )
            self._unknown[place] = np.s_[y : y + height, x : x + width] if width else None
        return stored, self._unknown[place]

    def _unknown_around(self, frame: int, position: Position) -> Box | None:
        """The box that holds all that is unknown in the four views around position, and as much around it as `SOFT` reaches."""
        rows, cols = self._offsets.shape[:2]
        r, c = cell_of(position[0], rows)[0], cell_of(position[1], cols)[0]
        if (frame, r, c) not in self._unknown_cells:
            corners = itertools.product((r, min(r + 1, rows - 1)), (c, min(c + 1, cols - 1)))
            boxes = [box for at in corners if (box := self._map(frame, *at)[1]) is not None]
            sides = zip(*boxes, strict=True)
            union = [
                slice(max(min(s.start for s in side) - SOFT, 0), max(s.stop for s in side) + SOFT)
                for side in sides
            ]
            self._unknown_cells[frame, r, c] = (union[0], union[1]) if boxes else None
        return self._unknown_cells[frame, r, c]

    def unknown(
        self, frame: int, position: Position, shift_px: Position
    ) -> tuple[Box, NDArray[np.float32]] | None:
        """Where a picture is cross-faded because disparity is unknown: a box of the picture, moved by shift_px as by `aim`, and
        the share of the cross-fade at each of its pixels, float32, 0 to 1. None if it is 0 everywhere."""
        around = self._unknown_around(frame, position)
        if around is None:
            return None
        low = np.zeros_like(self._low)
        for view in view_weights("blend", position, *self._offsets.shape[:2]):
            low[around] += np.float32(view.weight) * (
                self._map(frame, view.row, view.col)[0][around] == UNKNOWN
            )
        low[around] = cv2.blur(
            np.clip(2 * low[around] - 1, 0, 1), (SOFT, SOFT)
        )  # other views know the rest
        x, y, width, height = cv2.boundingRect((low > 0).view(np.uint8))
        if not width:
            return None
        even = self._step == (2.0, 2.0)  # then a part alone scales as in the whole
        if not even:
            x, y, width, height = 0, 0, len(low[0]), len(low)
        uncertain = low[max(y - 1, 0) : y + height + 1, max(x - 1, 0) : x + width + 1]
        size = (2 * uncertain.shape[1], 2 * uncertain.shape[0]) if even else self._size
        share = np.asarray(cv2.resize(uncertain, size, interpolation=cv2.INTER_LINEAR), np.float32)
        first = 2 * max(y - 1, 0), 2 * max(x - 1, 0)
        by = round(shift_px[0]), round(shift_px[1])
        spans = []
        for start, moved, length, most in zip(
            first, by, share.shape[:2], self._size[::-1], strict=True
        ):
            stop = start + length
            spans.append(
                slice(
                    max(start - moved, 0) if start else 0,
                    min(stop - moved, most) if stop < most else most,
                )
            )
        rows, cols = spans
        if rows.start >= rows.stop or cols.start >= cols.stop:
            return None
        box = rows, cols
        return box, shifted(share, by[0] - first[0], by[1] - first[1], box)

    def _look_up(
        self, band: Band, at: NDArray[np.float32], out: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The stored disparity at the place where each pixel of a band lands if its own is `at`. The nearest value: a mean of two
        would be neither."""
        x, y = _moved(at, self._low_moves, band.index, band.moved)
        cv2.remap(self._low, x, y, cv2.INTER_NEAREST, out, cv2.BORDER_REPLICATE)
        return out


def _moved(disparity: NDArray[np.float32], moves: Moves, start: Pair, out: Pair) -> Pair:
    """start + disparity * move[0] + move[1] along x and y, in out; start itself where nothing moves."""
    moved = list(start)
    for axis, (per_unit, shift) in enumerate(moves):
        if per_unit or shift:
            cv2.scaleAdd(disparity, per_unit, start[axis], out[axis])
            moved[axis] = out[axis]
        if shift:
            np.add(out[axis], shift, out=out[axis])  # cv2.add takes 4x1 arrays for scalars
    return moved[0], moved[1]


@lru_cache(maxsize=256)
def _box(down: int, right: int) -> NDArray[np.uint8]:
    return np.ones((2 * down + 1, 2 * right + 1), np.uint8)
