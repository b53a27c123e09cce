"""Maps the pixels of a new picture to positions in a stored view, with occlusion, and samples them
in overlapping blocks of 2x2 pixels: the cost of resampling is per lookup, hardly per byte.

The disparity of a view is stored at half its resolution, so four pixels share one displacement. If
a plane is stored as

    block(x, y) = (p(x, y), p(x + 1, y), p(x, y + 1), p(x + 1, y + 1))

one sample of four bytes, interpolated between blocks as between pixels, returns all four: a quarter
of the lookups. At 512x512 this takes 0.14 ms, plus 0.08 ms to pack and unpack, against 0.47 ms for
one plane pixel by pixel. On held-out views it costs at most 0.03 dB.
"""

import itertools
import math
from collections.abc import Iterator
from functools import cache, lru_cache
from typing import Any, TypeVar

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.synthesis.scene_views import SceneViews, not_owning, size_of
from lfpipe.render.synthesis.viewpoint import Position, ViewWeight, cell_of, view_weights
from lfpipe.scene.lightfield import UNKNOWN

Reach = tuple[int, int]  # first and last row of blocks that a band needs
Box = tuple[slice, slice]  # rows, columns of a picture
Pixel = TypeVar("Pixel", np.uint8, np.float32)
# blocks before the first pixel: the border is repeated outwards for each of a block's pixels
MARGIN = 1


def unaligned_array(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """A new uint8 array at an odd address: for aligned arrays, cv2.merge bypasses the caches, and
    the next reader waits for memory (512x512: sampling blocks takes 0.14 instead of 0.24 ms,
    merging three planes 0.020 instead of 0.029).
    """
    return np.zeros(math.prod(shape) + 1, np.uint8)[1:].reshape(shape)


def bands_of(rows: int, row_bytes: int, most_bytes: int = 320 << 10) -> list[slice]:
    """Rows in bands of about most_bytes, which stay in a core's cache; one band if the rows are not
    much larger. At 512x512 four bands take 8 % less time than one, at 1920x1080 bands of the usual
    size 5 % less than of three times that.
    """
    count = 1 if rows * row_bytes < 3 * most_bytes else math.ceil(rows * row_bytes / most_bytes)
    height = math.ceil(rows / count)
    return [slice(first, min(first + height, rows)) for first in range(0, rows, height)]


def split_rows(height_px: int, count: int) -> list[slice]:
    """The rows of a picture in at most `count` parts of whole blocks."""
    rows = 2 * math.ceil((height_px + 1) // 2 / count)
    return [slice(top, min(top + rows, height_px)) for top in range(0, height_px, rows)]


def shifted(plane: NDArray[Pixel], dy: int, dx: int, box: Box) -> NDArray[Pixel]:
    """A box of the picture with plane[y + dy, x + dx] at (y, x) and a repeated border: a part of
    the plane itself, or a new array.
    """
    rows, cols = box
    top, bottom, above, below = _clipped(rows.start + dy, rows.stop + dy, plane.shape[0])
    left, right, before, after = _clipped(cols.start + dx, cols.stop + dx, plane.shape[1])
    inside = plane[top:bottom, left:right]
    if above or below or before or after:
        edged = cv2.copyMakeBorder(inside, above, below, before, after, cv2.BORDER_REPLICATE)
        return np.asarray(edged, plane.dtype)
    return inside


def _clipped(first: int, end: int, size: int) -> tuple[int, int, int, int]:
    """The part of first to end inside an axis of this size: start and stop, at least one element
    apart, and the number of border repetitions before and after.
    """
    start = min(max(first, 0), size - 1)
    stop = max(min(end, size), 1)
    before = min(max(-first, 0), end - first - 1)
    return start, stop, before, end - first - (stop - start) - before


class Blocks:
    """Packs planes of one size into blocks and unpacks them; owns its buffers, so a call allocates
    nothing.
    """

    def __init__(self, height_px: int, width_px: int) -> None:
        self._size = height_px, width_px
        rows, cols = self._count = size_of(height_px, width_px)
        self._padded = np.empty((height_px + 2, width_px + 2), np.uint8)
        self._whole = unaligned_array((height_px + 1, width_px + 2, 4))
        self._rows: dict[
            int, tuple[NDArray[np.uint8], list[NDArray[np.uint8]], NDArray[np.uint8]]
        ] = {}
        self._even = np.empty((2 * rows, 2 * cols), np.uint8)

    def _rows_of(
        self, count: int
    ) -> tuple[NDArray[np.uint8], list[NDArray[np.uint8]], NDArray[np.uint8]]:
        """Buffers for this many rows of blocks: the padded plane, the four corners of its blocks,
        and the merged blocks.

        One long row, so that one call merges all; pixels that wrap around at the end of a row are
        never read.
        """
        if count not in self._rows:
            padded = self._padded[: count + 1]
            flat = padded.reshape(1, -1)
            wide = self._size[1] + 2
            length = flat.size - wide - 1
            corners = [flat[:, start : start + length] for start in (0, 1, wide, wide + 1)]
            self._rows[count] = padded, corners, self._whole.reshape(1, -1, 4)[:, :length]
        return self._rows[count]

    def lay(self, plane: NDArray[np.uint8], first: int, last: int) -> NDArray[np.uint8]:
        """Blocks at every pixel, MARGIN before the first: rows first to last, inclusive, of uint8
        (height + 1, width + 1, 4). Valid until the next call.
        """
        height, width = self._size
        above, below = int(first == 0), int(last == height)
        count = last - first + 1
        padded, corners, flat = self._rows_of(count)
        cv2.copyMakeBorder(
            plane[first - 1 + above : last + 1 - below],
            above,
            below,
            MARGIN,
            MARGIN,
            cv2.BORDER_REPLICATE,
            padded,
        )
        cv2.merge(corners, flat)
        return self._whole[:count, : width + 1]

    def reach(self, rows: slice, most_px: float) -> Reach:
        """The first and the last row of `lay` that rows of blocks need, if displaced by at most
        most_px.
        """
        height = self._size[0]
        if rows.stop - rows.start == self._count[0]:
            return 0, height
        first = min(max(math.floor(2 * rows.start + MARGIN - most_px), 0), height)
        last = min(max(math.ceil(2 * rows.stop - 2 + MARGIN + most_px), first), height)
        return first, last

    def sample(
        self,
        plane: NDArray[np.uint8],
        x: NDArray[np.float32],
        y: NDArray[np.float32],
        reach: Reach,
        out: NDArray[np.uint8],
    ) -> None:
        """out[i, j] = the block of plane at (x, y)[i, j], bilinear between pixels; x, y: `places`
        plus a displacement, y counted from the first row of reach.
        """
        cv2.remap(
            self.lay(plane, *reach),
            x,
            y,
            cv2.INTER_LINEAR,
            out,
            borderMode=cv2.BORDER_REPLICATE,
        )

    def pixels(self, blocks: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
        """Unpacks side-by-side blocks, uint8 (rows, columns, 4), into out, uint8 (height, width)
        with contiguous rows; or a band of them.
        """
        even = self._even[: 2 * len(blocks)]
        whole = out if out.shape == even.shape else even
        pairs, lines = blocks.view(np.uint16), whole.view(np.uint16)
        cv2.extractChannel(pairs, 0, lines[0::2])
        cv2.extractChannel(pairs, 1, lines[1::2])
        if whole is not out:
            np.copyto(out, whole[: out.shape[0], : out.shape[1]])


def places(height_px: int, width_px: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(x, y) in `Blocks.lay` of the side-by-side blocks that make up the undisplaced plane: float32
    (rows, columns) each.
    """
    rows, cols = size_of(height_px, width_px)
    y, x = np.mgrid[0:rows, 0:cols].astype(np.float32) * np.float32(2) + np.float32(MARGIN)
    return np.ascontiguousarray(x), np.ascontiguousarray(y)


# separation of near and far above which hidden parts are handled,
# at a seventh of the cost of a warp
CAREFUL_PX = 1.0
SOFT = 5  # values of disparity over which a cross-fade ramps up
BOX_SHARE = 0.02  # fixed cost of a box, relative to a whole map
MAX_BOXES = 30  # of unknown disparity: more are merged into one

Pair = tuple[NDArray[np.float32], NDArray[np.float32]]  # x, y
Levels = NDArray[np.uint8]  # disparity in stored units, plus ZERO
ZERO = 128


@attrs.frozen(eq=False)
class Unknown:
    """A box of the maps of four views in which some disparity is unknown."""

    box: Box  # including the margin of `SOFT`
    masks: dict[tuple[int, int], NDArray[np.float32]]  # by view: 1 if unknown, else 0


class Warper:
    """Sampling maps from the disparity of a light field, for some rows of pictures; owns its
    buffers, so a call allocates nothing.
    """

    def __init__(self, scene: SceneViews, drawn_rows: slice) -> None:
        if scene.field.disparity is None:
            raise ValueError("a light field without disparity cannot be warped")
        self._scene = scene
        self._map = scene.disparity
        rows, cols = size_of(scene.height_px, scene.width_px)
        if self._map(0, 0, 0).shape != (rows, cols):
            raise ValueError(
                f"disparity of {self._map(0, 0, 0).shape} values, not one for each 2x2 pixels:"
                f" {rows, cols}"
            )
        self._unknown_in = cache(not_owning(self._find_unknown))
        self._unknown_around = cache(not_owning(self._find_unknown_around))
        # px of a view per px of its disparity
        self._step = (scene.height_px / rows, scene.width_px / cols)
        self._size = scene.height_px, scene.width_px
        self._low, self._steps_up, self._nearest = np.empty((3, rows, cols), np.uint8)
        # x and y of each disparity, and of each block
        self._cells = np.ascontiguousarray(
            np.mgrid[:rows, :cols][::-1].transpose(1, 2, 0), np.int16
        )
        self._places = places(scene.height_px, scene.width_px)
        first, end = drawn_rows.start // 2, (drawn_rows.stop + 1) // 2
        self._drawn = first, end
        self.bands = [
            slice(first + band.start, first + band.stop)
            for band in bands_of(end - first, 16 * cols)
        ]
        """Rows of blocks to process at a time."""
        # scratch of a band
        size = self.bands[0].stop - first, cols
        self._steps_to = np.empty(size, np.int32)
        self._targets = np.empty((*size, 2), np.int16)
        self._moved = np.empty((2, *size), np.float32)
        self._first, self._second = np.empty((2, *size), np.uint8)
        self.reset()

    def reset(self) -> None:
        """Takes the disparities of the scene anew, which were replaced."""
        field, scale = self._scene.field, self._scene.scale
        self._unit_px = abs(float(field.disparity_scale_px)) * scale
        self._turned = field.disparity_scale_px < 0
        self._span_px = (field.disparity_max_px - field.disparity_min_px) * scale
        self._unknown_in.cache_clear()
        self._unknown_around.cache_clear()

    def aim(self, frame: int, view: ViewWeight, steps: Position, shift_px: Position) -> None:
        """Prepares `maps` for the view from `steps` away, moved by shift_px.

        steps, shift_px: (row, col).
        """
        down, right = steps
        shift_y, shift_x = shift_px
        stored = self._map(frame, view.row, view.col).view(np.uint8)
        levels, levels_up = LEVELS[self._turned]
        cv2.LUT(stored, levels, self._low)
        # by which a pixel is moved down or up at most
        self.most_px = ZERO * self._unit_px * abs(down) + abs(shift_y)
        per_level = np.array((right * self._unit_px, down * self._unit_px))
        # by level: px that a block moves along x and y; and whole cells
        moves = np.rint((_UNITS * per_level + (shift_x, shift_y)) / _STEP_PX) * _STEP_PX
        self._moves = np.ascontiguousarray(moves.T, np.float32)
        cells = np.floor(np.clip(moves / self._step[::-1], -_FAR, _FAR) + 0.5).astype(np.int16)
        self._cell_moves = cells.view(np.int32).reshape(1, 256)
        offset_y, offset_x = abs(down) * self._span_px, abs(right) * self._span_px
        # whether near and far surfaces separate enough for occlusion
        self._careful = max(offset_x, offset_y) >= CAREFUL_PX
        if not self._careful:
            return
        steps_up = self._low
        if self._unknown_in(frame, view.row, view.col):  # which is never nearest
            steps_up = self._steps_up
            cv2.LUT(stored, levels_up, steps_up)
        rows, cols = self._low.shape
        down = min(math.ceil(offset_y / self._step[0]), rows)
        right = min(math.ceil(offset_x / self._step[1]), cols)
        near = slice(max(self._drawn[0] - down, 0), self._drawn[1] + down)
        cv2.dilate(steps_up[near], _box(down, right), self._nearest[near])

    def maps(self, band: slice, first_row: int) -> Pair:
        """Maps (x, y), float32 (rows of band, columns) of blocks, that sample the view of `aim`.

        band: one of `bands`. first_row: of blocks, from which y counts. The maps are for
        `Blocks.sample`, not to be written to, and valid until the next call.

        They follow the view's disparity at the target of each pixel: d(x + d * steps). One
        iteration of the fixed point from d(x) suffices if little is hidden. If near and far
        separate by more than CAREFUL_PX, the search starts from the nearest object in reach, so
        that the front object wins. A point hidden in the view does not converge: it alternates
        between the front object and the background. The nearer value then samples the background
        next to the object.
        """
        count = band.stop - band.start
        first = self._first[:count]
        if self._careful:
            disparity = self._second[:count]
            self._look_up(band, self._nearest[band], first)
            self._look_up(band, first, disparity)
            cv2.max(first, disparity, disparity)
        else:
            disparity = first
            self._look_up(band, self._low[band], disparity)
        across, down = self._moves
        x, y = self._places
        moved_x, moved_y = self._moved[:, :count]
        return (
            _moved(disparity, across, x[band], moved_x),
            _moved(disparity, down - np.float32(first_row), y[band], moved_y),
        )

    def _find_unknown(self, frame: int, row: int, col: int) -> bool:
        """Whether some disparity of a view is unknown."""
        return bool(self._map(frame, row, col).min() == UNKNOWN)

    def _find_unknown_around(self, frame: int, row: int, col: int) -> list[Unknown]:
        """The boxes with unknown disparity in the four views from (row, col) on."""
        rows, cols = self._scene.field.rows, self._scene.field.cols
        corners = itertools.product((row, min(row + 1, rows - 1)), (col, min(col + 1, cols - 1)))
        masks = {
            at: (self._map(frame, *at) == UNKNOWN).view(np.uint8)
            for at in corners
            if self._unknown_in(frame, *at)
        }
        around = np.zeros(self._low.shape, np.uint8)
        for mask in masks.values():
            around |= mask
        cv2.dilate(around, _box(SOFT, SOFT), around)
        return [
            Unknown(box, {at: mask[box].astype(np.float32) for at, mask in masks.items()})
            for box in _boxes_of(around)
        ]

    def unknown(
        self, frame: int, position: Position, shift_px: Position
    ) -> Iterator[tuple[Box, NDArray[np.float32]]]:
        """The parts to cross-fade because disparity is unknown: boxes of the picture, moved by
        shift_px as by `aim`, and the share of the cross-fade at each of their pixels, float32, 0 to
        1. It is 0 elsewhere.
        """
        rows, cols = self._scene.field.rows, self._scene.field.cols
        row, _ = cell_of(position[0], rows)
        col, _ = cell_of(position[1], cols)
        areas = self._unknown_around(frame, row, col)
        if not areas:
            return
        views = view_weights("blend", position, rows, cols)
        dy, dx = round(shift_px[0]), round(shift_px[1])
        for area in areas:
            top, left = area.box[0].start, area.box[1].start
            low = np.full_like(next(iter(area.masks.values())), -1)  # not unknown in other views
            for view in views:
                if (mask := area.masks.get((view.row, view.col))) is not None:
                    cv2.scaleAdd(mask, 2 * view.weight, low, low)
            cv2.max(low, 0, low)  # type: ignore[call-overload]
            if not low.any():
                continue
            cv2.blur(low, (SOFT, SOFT), low)
            share = cv2.resize(low, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
            box = (
                _span(2 * top, len(share), dy, self._size[0]),
                _span(2 * left, len(share[0]), dx, self._size[1]),
            )
            if box[0].start < box[0].stop and box[1].start < box[1].stop:
                yield (
                    box,
                    shifted(np.asarray(share, np.float32), dy - 2 * top, dx - 2 * left, box),
                )

    def _look_up(self, band: slice, at: Levels, out: Levels) -> None:
        """Writes to out the stored disparity at the place where each pixel of a band lands if its
        own is `at`. The nearest value: a mean of two would be neither.
        """
        steps, targets = self._steps_to[: len(at)], self._targets[: len(at)]
        cv2.LUT(at, self._cell_moves, steps)
        cv2.add(self._cells[band], steps.view(np.int16).reshape(targets.shape), targets)
        second: Any = None  # targets hold both coordinates
        cv2.remap(self._low, targets, second, cv2.INTER_NEAREST, out, cv2.BORDER_REPLICATE)


def _moved(
    disparity: Levels,
    move: NDArray[np.float32],
    start: NDArray[np.float32],
    out: NDArray[np.float32],
) -> NDArray[np.float32]:
    """start + move[disparity], in out; start itself if nothing moves."""
    if not move.any():
        return start
    cv2.LUT(disparity, move[None], out)
    cv2.add(start, out, out)
    return out


def _levels(turned: bool) -> tuple[Levels, Levels]:
    """Tables from a stored byte to its level. Unknown is ZERO in the first, and below all others in
    the second. turned: depth is inverted.
    """
    up = np.arange(256, dtype=np.uint8) ^ np.uint8(ZERO)
    if turned:
        up = np.negative(up)  # 1 to 255 in reverse; 0, unknown, stays
    levels = up.copy()
    levels[np.int8(UNKNOWN).view(np.uint8)] = ZERO
    return levels, up


LEVELS = _levels(False), _levels(True)  # the second: depth is inverted
_UNITS = np.arange(256)[:, None] - float(ZERO)
_STEP_PX = 1 / 1024  # of a move: its sum with a position is then exact in any band
_FAR = 1 << 14  # cells beyond any picture, so that the sum with a position fits into 16 bits


def _span(start: int, length: int, moved: int, most: int) -> slice:
    """The pixels on an axis of `most` that show start to start + length of a plane after a move; a
    part at the border of the plane extends to that of the picture.
    """
    stop = start + length
    return slice(
        max(start - moved, 0) if start else 0, min(stop - moved, most) if stop < most else most
    )


def _boxes_of(mask: NDArray[np.uint8]) -> list[Box]:
    """Boxes that cover a mask, uint8 (h, w), with the least work."""
    count, _, areas, _ = cv2.connectedComponentsWithStats(mask)
    rects = areas[1:, :4].tolist() if count - 1 <= MAX_BOXES else [cv2.boundingRect(mask)]
    boxes = [(y, x, y + height, x + width) for x, y, width, height in rects]

    def work(box: tuple[int, int, int, int]) -> float:
        return (box[2] - box[0]) * (box[3] - box[1]) + BOX_SHARE * mask.size

    def joined(
        a: tuple[int, int, int, int], b: tuple[int, int, int, int]
    ) -> tuple[int, int, int, int]:
        return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])

    def saved(pair: tuple[tuple[int, int, int, int], tuple[int, int, int, int]]) -> float:
        return work(pair[0]) + work(pair[1]) - work(joined(*pair))

    while len(boxes) > 1:
        pair = max(itertools.combinations(boxes, 2), key=saved)
        if saved(pair) <= 0:
            break
        boxes = [box for box in boxes if box not in pair] + [joined(*pair)]
    return [np.s_[top:bottom, left:right] for top, left, bottom, right in boxes]


@lru_cache(maxsize=256)
def _box(down: int, right: int) -> NDArray[np.uint8]:
    return np.ones((2 * down + 1, 2 * right + 1), np.uint8)
