"""What pictures look like: the least of the evidence, where neither files nor names say it.

The columns of a running number: views that are near in the grid look alike. For each candidate
grid, the difference between some pairs of views is correlated with their distance in the grid. The
grid with the highest correlation wins; if another one comes close, the result is marked ambiguous.
The tiles of a mosaic repeat themselves; a pair moves along its rows; an anaglyph holds a pair in
its colours.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import combinations
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.optical_flow import returned_flow, textured
from lfpipe.scene.source import ViewIndex

_SIDE_PX = 96  # of the small pictures that are compared
_MAX_PICTURES = 64  # to decode
# grid steps over which the difference saturates: short for wide baselines, long for narrow ones
_REACHES = (1.5, 4.0, 12.0, 40.0)
_CLEAR = 0.02  # lead in correlation of a clear grid
MIN_VIEW_PX = 12  # side of a view: a smaller one shows nothing
_GLANCE_PX = 1024  # longer side of the reduced picture in which tiles are detected
_TWO_AXES, _ONE_AXIS = 0.5, 0.2  # limits of `_unlike` for neighbouring tiles
_SEAM = 0.1  # share of a tile's lines that may change more than its borders
_EYES_PX = 384  # longer side of the pictures of two eyes that are compared
_AGREED = 0.5  # minimum share of the detail of a pair that flow matches
_ASIDE_PX = 1.5  # shift between red and green: more than lens errors
_DOWN_SHARE = 0.15  # of the motion across: both eyes are at one height


@attrs.frozen(kw_only=True)
class Running:
    """How a running number fills a grid: row by row."""

    rows: int
    cols: int
    upwards: int = 0  # for a quilt: tiles in a row; its lowest row is the first
    doubt: str = ""  # what stays ambiguous

    def index(self, position: int) -> ViewIndex:
        """The grid index of a position in the run."""
        if self.upwards:
            row, col = divmod(position, self.upwards)
            position = (self.cols // self.upwards - 1 - row) * self.upwards + col
        return divmod(position, self.cols)


def reduced(picture: NDArray[Any], most_px: float) -> NDArray[Any]:
    """A picture whose longer side is at most that long."""
    scale = min(1.0, most_px / max(picture.shape[:2]))
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _normalised(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """A small copy of a picture, of mean 0 and variance 1, to be compared."""
    small = reduced(picture, _SIDE_PX).astype(np.float32)
    return np.asarray((small - small.mean()) / max(1.0, float(small.std())), np.float32)


def _positions(present: Sequence[bool], tries: Sequence[Running]) -> list[int]:
    """Positions to compare: all of a short run, else some in the middle and, for each candidate,
    those one row below.
    """
    count = len(present)
    if count <= _MAX_PICTURES:
        return [position for position in range(count) if present[position]]
    middle = count // 2
    strides = sorted({run.cols for run in tries if run.rows > 1 and run.cols < count // 2})
    order = [middle + near for near in (0, 1, 2, 3, -1, -2, 4, -3)]
    order += [
        middle + sign * (stride + near) for stride in strides for near in (0, 1) for sign in (1, -1)
    ]
    usable = dict.fromkeys(
        position for position in order if 0 <= position < count and present[position]
    )
    return list(usable)[:_MAX_PICTURES]


def likeliest(
    read: Callable[[int], NDArray[np.uint8]], present: Sequence[bool], tries: Sequence[Running]
) -> tuple[Running, list[Running]]:
    """The candidate that explains the similarity of the pictures best, and those of another shape
    that come close.

    read(position): a view, any size; present: whether there is a view, by position.
    """

    small = cache(lambda position: _normalised(read(position)))
    pairs = np.array(list(combinations(_positions(present, tries), 2)))
    unlike = np.array(
        [
            float(np.abs(small(a) - small(b)).mean()) if small(a).shape == small(b).shape else 2.0
            for a, b in pairs
        ]
    )
    # among equals, the squarest grid
    order = sorted(tries, key=lambda run: abs(run.rows - run.cols))
    score = {run: round(_explained(run, pairs, unlike), 4) for run in order}
    best = max(order, key=score.__getitem__)
    near = [
        run
        for run in sorted(order, key=score.__getitem__, reverse=True)
        if (run.rows, run.cols) != (best.rows, best.cols) and score[run] > score[best] - _CLEAR
    ]
    return best, near


def find_columns(
    read: Callable[[int], NDArray[np.uint8]], present: Sequence[bool], grid: ViewIndex | None = None
) -> Running | None:
    """The grid of a run of views, by the pictures; None if the user's grid does not fit it."""
    count = len(present)
    if grid:
        return Running(rows=grid[0], cols=grid[1]) if grid[0] * grid[1] == count else None
    columns = (count, *(cols for cols in range(2, count // 2 + 1) if count % cols == 0))
    best, near = likeliest(read, present, [Running(rows=count // n, cols=n) for n in columns])
    if not near:
        return best
    # lines are more common than narrow grids
    shown = next((run for run in near if run.rows == 1), best)
    either = " or ".join(f"{r.rows}x{r.cols}" for r in (best, *near) if r != shown)
    doubt = f"the grid: {shown.rows}x{shown.cols}, or {either} (--set scene.grid=ROWSxCOLS)"
    return attrs.evolve(shown, doubt=doubt)


def _explained(run: Running, pairs: NDArray[np.int64], unlike: NDArray[np.float64]) -> float:
    """Correlation of the pictures' difference with distance in the grid; -1 if they are not less
    alike along either side, or if there are too few pairs for a correlation.
    """
    if not len(pairs) or unlike.std() <= 1e-9:
        return -1.0
    place = np.array([[run.index(a), run.index(b)] for a, b in pairs.tolist()], np.float64)
    rows, cols = np.abs(place[:, 0] - place[:, 1]).T
    best = -1.0
    for reach in _REACHES:
        far = [1 - np.exp(-away / reach) for away in (rows, cols, np.hypot(rows, cols))]
        sides = [side for side in far[:2] if side.std() > 1e-9]
        growth = np.linalg.lstsq(np.stack([np.ones_like(unlike), *sides], 1), unlike, rcond=None)[0]
        if sides and growth[1:].min() > 0:
            best = max(best, float(np.corrcoef(far[2], unlike)[0, 1]))
    return best


def plane_of(picture: NDArray[Any]) -> NDArray[np.uint8]:
    """The only plane of a picture, or its green one, with 8 bits."""
    plane = picture if picture.ndim == 2 else picture[..., 1]
    return np.ascontiguousarray(plane if plane.dtype == np.uint8 else (plane >> 8).astype(np.uint8))


def _changed(grey: NDArray[np.float32], axis: int, by_px: int) -> float:
    """Mean square difference between a picture and itself, shifted along an axis."""
    here, there = (
        (grey[by_px:], grey[:-by_px]) if axis == 0 else (grey[:, by_px:], grey[:, :-by_px])
    )
    return cv2.norm(here, there, cv2.NORM_L2SQR) / here.size


def dip(grey: NDArray[np.float32], axis: int, period: float) -> float:
    """Mean square difference between a picture and itself, shifted by one period along an axis,
    relative to shifts of half a period more or less; 1 for a plain picture. It is small for a
    repeating picture; in an ordinary one the difference only grows with the shift.
    """
    at, less, more = (_changed(grey, axis, round(period * by)) for by in (1, 0.5, 1.5))
    return at / min(less, more) if min(less, more) > 1e-3 else 1.0


def _unlike(grey: NDArray[np.float32], axis: int) -> dict[int, float]:
    """The dip at a shift of one tile, by number of tiles along an axis."""
    size = grey.shape[axis]
    return {count: dip(grey, axis, size / count) for count in range(2, size // 8 + 1)}


def _seams(grey: NDArray[np.float32], axis: int, count: int) -> bool:
    """Whether the picture changes more at the borders of so many tiles than nearly everywhere else
    in them. A wall of windows repeats itself, too, but not by a share of the picture.
    """
    lines = grey if axis == 0 else grey.T
    change = cv2.dilate(np.abs(np.diff(lines, axis=0)).mean(axis=1)[None], np.ones((1, 3)))[0]
    tile = len(lines) / count
    away = np.arange(int(tile))
    borders = np.rint(tile * np.arange(1, count)).astype(int) - 1
    phases = change[np.minimum(borders[:, None] + away - len(away) // 2, len(change) - 1)].mean(
        axis=0
    )
    return bool((phases > phases[len(away) // 2]).mean() < _SEAM)


def _period(
    grey: NDArray[np.float32], axis: int, full_px: int, unlike: Mapping[int, float]
) -> tuple[int, float]:
    """The number of tiles with the most similar neighbours along an axis, and their difference
    (1, 1.0) if there is none. A number that does not divide the side must have seams.
    """
    fits = {
        n: u
        for n, u in unlike.items()
        if full_px // n >= MIN_VIEW_PX
        and (full_px % n == 0 or (u < _TWO_AXES and _seams(grey, axis, n)))
    }
    best = min(fits, key=lambda n: fits[n], default=1)
    return best, fits.get(best, 1.0)


def find_tiles(picture: NDArray[Any], name: str = "") -> ViewIndex | None:
    """Rows and columns of a picture's tiles; None if it does not nearly repeat itself after one.

    name: of the file or folder; a grid in the name (9x9) is used unless the picture contradicts it.
    """
    height, width = picture.shape[:2]
    small = reduced(picture, _GLANCE_PX)  # reducing a single plane would copy it
    plane = (small if small.ndim == 2 else small[..., 1]).astype(np.float32)
    down, across = _unlike(plane, 0), _unlike(plane, 1)
    for named in re.finditer(r"(?<!\d)(\d{1,2})x(\d{1,2})(?!\d)", name):
        rows, cols = int(named[1]), int(named[2])
        unlike = max(down.get(rows, 0), across.get(cols, 0))
        if rows * cols > 1 and not (height % rows or width % cols) and unlike < 1:
            return rows, cols
    rows, row_unlike = _period(plane, 0, height, down)
    cols, col_unlike = _period(plane, 1, width, across)
    if max(row_unlike, col_unlike) < _TWO_AXES:
        return rows, cols
    if col_unlike < _ONE_AXIS and cols > 2:
        return 1, cols
    if row_unlike < _ONE_AXIS and rows > 2:
        return rows, 1
    return None


def are_a_pair(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether two pictures of equal size show one scene from two positions side by side."""
    greys = [plane_of(reduced(picture, _EYES_PX)) for picture in (a, b)]
    if min(greys[0].shape) < 24 or min(float(grey.std()) for grey in greys) < 2:
        return False
    to_right, confirmed = returned_flow(*greys)
    detail = textured(greys[0])
    agreed = confirmed & (np.abs(to_right[..., 1]) < 1.5 + 0.1 * np.abs(to_right[..., 0]))
    return bool(detail.any()) and float(agreed[detail].mean()) > _AGREED


def are_frames(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether two pictures may be frames of one video."""
    small = [
        cv2.resize(plane_of(picture), (32, 32), interpolation=cv2.INTER_AREA) for picture in (a, b)
    ]
    return min(look.std() for look in small) > 1 and bool(
        np.corrcoef(small[0].ravel(), small[1].ravel())[0, 1] > 0.5
    )


def is_anaglyph(picture: NDArray[Any]) -> bool:
    """Whether red is shifted against green, as between the pictures of two eyes."""
    small = reduced(picture, _EYES_PX)
    if picture.ndim == 2 or min(small.shape[:2]) < 24:
        return False
    red, green = (
        np.asarray(cv2.equalizeHist(plane_of(small[..., channel])), np.uint8) for channel in (0, 1)
    )
    aside, confirmed = returned_flow(red, green)
    detail = confirmed & textured(green)
    if not detail.any():
        return False
    across, down = np.abs(aside[detail]).T
    across_px = float(np.percentile(across, 70))
    return bool(across_px > _ASIDE_PX and np.median(down) < max(0.5, _DOWN_SHARE * across_px))
