"""Many views in one picture: detects the tiles, cuts them out, and distinguishes a quilt from a grid."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.disparity import flow
from lfpipe.scene.files import Listing, picture_header, read_picture
from lfpipe.scene.layouts._grid import parse_grid

MOST_TILES = 64  # along one side
# Sizes and tiles (columns, rows) of displays whose tiles do not divide the picture: the remainder is at the right and the bottom.
UNEVEN = {(4096, 4096): (5, 9), (8192, 8192): (5, 9)}
_SMALLEST_TILE_PX = 24
_LARGE_BYTES = 64_000_000  # of a picture
_GLANCE_PX = 1024  # longer side of the reduced picture in which tiles are detected
_TWO_AXES, _ONE_AXIS = 0.5, 0.2  # limits of `_unlike` for neighbouring tiles


@attrs.frozen
class Tiling:
    """The division of a picture into tile_rows x tile_cols tiles. quilt: one row of views from the bottom left tile to the right,
    then upwards (downwards with `down`)."""

    tile_rows: int
    tile_cols: int
    quilt: bool = False
    down: bool = False

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of views."""
        return (1, self.tile_rows * self.tile_cols) if self.quilt else (self.tile_rows, self.tile_cols)

    def cut(self, picture: NDArray[Any], row: int, col: int) -> NDArray[Any]:
        """One view; the remainder at the right and the bottom belongs to none."""
        if self.quilt:
            row, col = divmod(col, self.tile_cols)
            row = row if self.down else self.tile_rows - 1 - row
        height, width = picture.shape[0] // self.tile_rows, picture.shape[1] // self.tile_cols
        return picture[row * height : (row + 1) * height, col * width : (col + 1) * width]


class LastPictures:
    """A cache of the last two pictures by frame number (one if they are large), for readers in several threads."""

    def __init__(self, load: Callable[[int], NDArray[Any]]) -> None:
        self._load = load
        self._lock = threading.Lock()
        self._kept: dict[int, NDArray[Any]] = {}

    def __call__(self, frame: int) -> NDArray[Any]:
        with self._lock:
            if frame not in self._kept:
                while self._kept and (len(self._kept) > 1 or next(iter(self._kept.values())).nbytes > _LARGE_BYTES):
                    del self._kept[min(self._kept)]
                self._kept[frame] = self._load(frame)
            return self._kept[frame]


def single_picture(listing: Listing) -> Path | None:
    """The picture of a scene of one picture: the given file, or the only picture of the folder."""
    pictures = listing.pictures()
    return listing.file(pictures[0]) if len(pictures) == 1 else None


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


def find_tiles(picture: NDArray[Any], name: str) -> tuple[int, int] | None:
    """(rows, cols) of the tiles of a picture, or None: a mosaic nearly repeats itself after one tile, a picture does not.

    name: of the file or folder; a grid named in it (9x9) is used unless the picture contradicts it.
    """
    height, width = picture.shape[:2]
    if (width, height) in UNEVEN:
        preset = UNEVEN[width, height]
        if find_tiles(picture[: height - height % preset[1], : width - width % preset[0]], name) == preset[::-1]:
            return preset[1], preset[0]
    scale = min(1.0, _GLANCE_PX / max(height, width))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)  # of a single plane it would be a copy
    plane = (small if small.ndim == 2 else small[..., 1]).astype(np.float32)
    down, across = _unlike(plane, 0), _unlike(plane, 1)
    for found in re.finditer(r"(?<!\d)(\d{1,2})x(\d{1,2})(?!\d)", name):
        rows, cols = int(found[1]), int(found[2])
        if rows * cols > 1 and not (height % rows or width % cols) and (down.get(rows, 0) < 0.8 and across.get(cols, 0) < 0.8):
            return rows, cols
    (rows, row_unlike), (cols, col_unlike) = _period(down, height), _period(across, width)
    if row_unlike < _TWO_AXES and col_unlike < _TWO_AXES:
        return rows, cols
    if col_unlike < _ONE_AXIS and cols > 2:
        return 1, cols
    return (rows, 1) if row_unlike < _ONE_AXIS and rows > 2 else None


def _grey(tile: NDArray[Any]) -> NDArray[np.uint8]:
    plane = tile if tile.ndim == 2 else tile[..., 1]
    return np.ascontiguousarray(plane if plane.dtype == np.uint8 else (plane >> 8).astype(np.uint8))


def detect_quilt(picture: NDArray[Any], rows: int, cols: int) -> Tiling:
    """The tiling of a picture of rows x cols tiles: a quilt if vertically adjacent tiles differ only sideways."""
    plain = Tiling(rows, cols)
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
    return Tiling(rows, cols, quilt=True, down=downwards < upwards)


def tiling(picture: NDArray[Any], path: Path, scene: config.Scene) -> Tiling:
    """The tiling of the picture at path: from scene.grid, else detected. Raises UserError."""
    height, width = picture.shape[:2]
    grid = parse_grid(scene.grid) or find_tiles(picture, f"{path.parent.name}/{path.stem}")
    if grid is None:
        raise UserError(f"{path}: no tiles recognised in {width}x{height} px", "give them with --set scene.grid=ROWSxCOLS")
    if (height % grid[0] or width % grid[1]) and UNEVEN.get((width, height)) != grid[::-1]:
        raise UserError(
            f"{path}: {width}x{height} px do not divide into {grid[0]} rows and {grid[1]} columns of tiles",
            "give the grid that was rendered with --set scene.grid=ROWSxCOLS",
        )
    return detect_quilt(picture, *grid) if not scene.grid else Tiling(*grid)


def picture_loader(paths: list[Path]) -> LastPictures:
    """Pictures by frame number. Raises UserError if their sizes differ, and on reading a damaged one."""
    headers = [picture_header(path) for path in paths]
    sizes = [f"{header.width_px}x{header.height_px}" for header in headers]
    for path, size in zip(paths, sizes, strict=True):
        if size != sizes[0]:
            what = f"{path}: {size} px, {paths[0].name} has {sizes[0]}"
            raise UserError(what, "all frames of a light-field video must have the same size")
    return LastPictures(lambda frame: read_picture(paths[frame], headers[frame])[0])
