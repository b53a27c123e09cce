"""Finds the tiles of a picture of many views: by lines of one colour between them, or because neighbouring tiles are alike."""

import re
from itertools import pairwise
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.layouts._tiling import UNEVEN, Tiling
from lfpipe.scene.optical_flow import flow

MOST_TILES = 64  # along one side
_SMALLEST_TILE_PX = 24
_GLANCE_PX = 1024  # longer side of the reduced picture in which tiles are detected
_TWO_AXES, _ONE_AXIS = 0.5, 0.2  # limits of `_unlike` for neighbouring tiles
_LINE_LEVELS, _LINE_SHARE = (4, 16, 48), 0.98  # grey levels from the colour of lines (JPEG blurs them), and share of a line
_LINE_SAMPLES = 64  # along a line
_SOFT_PX = 2  # by which lines and tiles differ where lines have soft edges


def _unlike(grey: NDArray[np.float32], axis: int) -> dict[int, float]:
    """By number of tiles along an axis: mean square difference at a shift of one tile, relative to shifts of half a tile more or
    less. A mosaic has a dip there; the difference of an ordinary picture only grows with the shift."""
    size = grey.shape[axis]

    def difference(shift: int) -> float:
        a, b = (grey[shift:], grey[:-shift]) if axis == 0 else (grey[:, shift:], grey[:, :-shift])
        return float(np.mean((a - b) ** 2))

    found: dict[int, float] = {}
    for count in range(2, MOST_TILES + 1):
        shift = size / count
        if shift < 8:
            break
        beside = min(difference(round(shift * 0.5)), difference(round(shift * 1.5)))
        found[count] = difference(round(shift)) / beside if beside > 1e-3 else 1.0
    return found


def _period(unlike: dict[int, float], full_px: int) -> tuple[int, float]:
    """The number of tiles whose neighbours are most alike, and their difference; (1, 1.0) if no number divides."""
    fits = {n: u for n, u in unlike.items() if full_px % n == 0 and full_px // n >= _SMALLEST_TILE_PX}
    best = min(fits, key=lambda n: fits[n], default=1)
    return best, fits.get(best, 1.0)


def _between_lines(picture: NDArray[Any]) -> list[tuple[int, int]]:
    """(first, last + 1) of the rows between lines of one colour, where these divide the picture evenly; else all rows as one."""
    height, width = picture.shape[:2]
    some = np.asarray(picture[:, :: max(1, width // _LINE_SAMPLES)], np.float32).reshape(height, -1, picture[0, 0].size)
    some *= np.float32(255 / max(1.0, float(some.max())))
    middle = np.median(some, axis=1, keepdims=True)
    colour = middle[np.abs(some - middle).max(axis=2).mean(axis=1).argmin()]
    off = np.abs(some - colour).max(axis=2)
    found = [(0, height)]
    for levels in _LINE_LEVELS:
        runs = _runs((off < levels).mean(axis=1) > _LINE_SHARE)
        if len(runs) == 1 == len(found) or (len(runs) > len(found) and _even(runs, height)):
            least = min(last - first for first, last in runs)  # soft edges of a line belong to it
            found = [(first, first + least) for first, _ in runs]
    return found


def _runs(plain: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(first, last + 1) of the places between plain ones."""
    edges = np.flatnonzero(np.diff(np.concatenate(([True], plain, [True])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _even(runs: list[tuple[int, int]], whole_px: int) -> bool:
    """Whether runs have one size and lines between them another, smaller one."""
    sizes, gaps = [last - first for first, last in runs], [b[0] - a[1] for a, b in pairwise(runs)]
    if len(runs) > MOST_TILES or min(sizes) < _SMALLEST_TILE_PX or max(sizes) - min(sizes) > _SOFT_PX:
        return False
    around = runs[0][0] + whole_px - runs[-1][1]
    margins = 0 < around <= 1.5 * min(gaps)  # of tiles with a plain background: they belong to the tiles
    return not margins and max(gaps) - min(gaps) <= _SOFT_PX and 4 * max(gaps) < min(sizes)


def _by_lines(picture: NDArray[Any]) -> Tiling | None:
    """The tiles of a picture with lines between them, as contact sheets and plots have; None without such lines."""
    down = _between_lines(picture)
    across = _between_lines(picture.swapaxes(0, 1))
    if len(down) * len(across) < 3:  # one photograph in a frame, or two, is no mosaic
        return None
    (top, bottom), (left, right) = down[0], across[0]
    return Tiling(tuple(first for first, _ in down), tuple(first for first, _ in across), bottom - top, right - left)


def find_tiles(picture: NDArray[Any], name: str) -> Tiling | None:
    """The tiles of a picture, or None: a mosaic has lines between its tiles, or nearly repeats itself after one tile.

    name: of the file or folder; a grid named in it (9x9) is used unless the picture contradicts it.
    """
    height, width = picture.shape[:2]
    lined = _by_lines(picture)
    if lined is not None:
        return lined
    if (width, height) in UNEVEN:
        cols, rows = UNEVEN[width, height]
        found = find_tiles(picture[: height - height % rows, : width - width % cols], name)
        if found is not None and found.shape == (rows, cols):
            return found
    scale = min(1.0, _GLANCE_PX / max(height, width))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)  # of a single plane it would be a copy
    plane = (small if small.ndim == 2 else small[..., 1]).astype(np.float32)
    down, across = _unlike(plane, 0), _unlike(plane, 1)
    for named in re.finditer(r"(?<!\d)(\d{1,2})x(\d{1,2})(?!\d)", name):
        rows, cols = int(named[1]), int(named[2])
        if rows * cols > 1 and not (height % rows or width % cols) and (down.get(rows, 0) < 0.8 and across.get(cols, 0) < 0.8):
            return Tiling.even(picture, rows, cols)
    (rows, row_unlike), (cols, col_unlike) = _period(down, height), _period(across, width)
    if row_unlike < _TWO_AXES and col_unlike < _TWO_AXES:
        return Tiling.even(picture, rows, cols)
    if col_unlike < _ONE_AXIS and cols > 2:
        return Tiling.even(picture, 1, cols)
    return Tiling.even(picture, rows, 1) if row_unlike < _ONE_AXIS and rows > 2 else None


def _grey(tile: NDArray[Any]) -> NDArray[np.uint8]:
    plane = tile if tile.ndim == 2 else tile[..., 1]
    return np.ascontiguousarray(plane if plane.dtype == np.uint8 else (plane >> 8).astype(np.uint8))


def detect_quilt(picture: NDArray[Any], plain: Tiling) -> Tiling:
    """The tiling of a picture: a quilt if vertically adjacent tiles differ only sideways."""
    rows, cols = plain.shape
    tiles = [[_grey(plain.cut(picture, r, c)) for c in range(cols)] for r in range(rows)]
    if min(rows, cols) < 2 or min(tiles[0][0].shape) < _SMALLEST_TILE_PX:
        return plain
    side = up_down = 0.0
    for r, c in ((rows // 2 - 1, cols // 2), (0, 0), (rows - 2, cols - 1)):
        shift = flow(tiles[r][c], tiles[r + 1][c])
        low, high = np.percentile(shift.reshape(-1, 2), (5, 95), axis=0)
        side += float(high[0] - low[0])
        up_down += float(high[1] - low[1])
    if side < 2 * up_down or side < 0.5:
        return plain

    def step(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
        return float(cv2.norm(a, b, cv2.NORM_L1))

    upwards = sum(step(tiles[r + 1][-1], tiles[r][0]) for r in range(rows - 1))
    downwards = sum(step(tiles[r][-1], tiles[r + 1][0]) for r in range(rows - 1))
    return attrs.evolve(plain, quilt=True, down=downwards < upwards)
