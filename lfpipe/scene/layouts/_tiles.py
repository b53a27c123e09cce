"""Pictures of many tiles, one view each: finds the tiles by the similarity of neighbours, and
decides whether they form a grid or one line, as in a quilt.
"""

import re
import threading
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import VIDEOS, Listing
from lfpipe.scene.layouts._grid import MIN_VIEW_PX, parse_grid
from lfpipe.scene.layouts._running import Running, likeliest, reduced

# Looking Glass: columns, rows, aspect
QUILT_NAME = re.compile(r"_qs([1-9][0-9]?)x([1-9][0-9]?)(?:a[\d.]+)?", re.IGNORECASE)
MAX_TILES = 64  # along one side
_GLANCE_PX = 1024  # longer side of the reduced picture in which tiles are detected
# limits of `_unlike` for neighbouring tiles; above the last, there are no tiles
_TWO_AXES, _ONE_AXIS, _PLAIN = 0.5, 0.2, 0.8
_SEAM = 0.1  # share of a tile's lines that may change more than its borders
_ALIKE = 0.03  # differences by which tiles are as much alike as tiles of tiles


def plane_of(picture: NDArray[Any]) -> NDArray[np.uint8]:
    """The only plane of a picture, or its green one, with 8 bits."""
    plane = picture if picture.ndim == 2 else picture[..., 1]
    return np.ascontiguousarray(plane if plane.dtype == np.uint8 else (plane >> 8).astype(np.uint8))


@attrs.frozen(kw_only=True)
class Tiling:
    """The positions of a picture's tiles, and their common size."""

    tops: tuple[int, ...]  # px
    lefts: tuple[int, ...]  # px
    height_px: int
    width_px: int
    quilt: bool = False  # one row of views, from the bottom left tile to the right, then upwards
    doubt: str = ""  # what the pictures leave ambiguous, "" for nothing

    @classmethod
    def even(cls, picture: NDArray[Any], rows: int, cols: int, resized: bool = True) -> "Tiling":
        """Tiles of one size without gaps. If they do not divide the picture, they are at fractional
        positions (resized), or leave a remainder at the right and the bottom.
        """
        height, width = picture.shape[0] // rows, picture.shape[1] // cols
        down, across = height, width
        if resized:
            down, across = picture.shape[0] / rows, picture.shape[1] / cols
        return cls(
            tops=tuple(round(down * r) for r in range(rows)),
            lefts=tuple(round(across * c) for c in range(cols)),
            height_px=height,
            width_px=width,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return len(self.tops), len(self.lefts)

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of views."""
        return (1, len(self.tops) * len(self.lefts)) if self.quilt else self.shape

    def cut(self, picture: NDArray[Any], row: int, col: int) -> NDArray[Any]:
        """One view."""
        if self.quilt:
            row, col = divmod(col, len(self.lefts))
            row = len(self.tops) - 1 - row
        top = self.tops[row]
        left = self.lefts[col]
        return picture[top : top + self.height_px, left : left + self.width_px]


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
    return {
        count: dip(grey, axis, size / count) for count in range(2, min(MAX_TILES, size // 8) + 1)
    }


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
    (1, 1.0) if there is none. A number that does not divide the side must have seams; tiles of
    tiles are no tiles.
    """
    fits = {
        n: u
        for n, u in unlike.items()
        if full_px // n >= MIN_VIEW_PX
        and (full_px % n == 0 or (u < _TWO_AXES and _seams(grey, axis, n)))
    }
    best = min(fits, key=lambda n: fits[n], default=1)
    best = max((n for n in fits if n % best == 0 and fits[n] < fits[best] + _ALIKE), default=best)
    return best, fits.get(best, 1.0)


def find_tiles(picture: NDArray[Any], name: str = "") -> Tiling | None:
    """The tiles of a picture, or None: a mosaic nearly repeats itself after one tile.

    name: of the file or folder; a grid in the name (9x9) is used unless the picture contradicts it.
    """
    height, width = picture.shape[:2]
    small = reduced(picture, _GLANCE_PX)  # reducing a single plane would copy it
    plane = (small if small.ndim == 2 else small[..., 1]).astype(np.float32)
    down, across = _unlike(plane, 0), _unlike(plane, 1)
    for named in re.finditer(r"(?<!\d)(\d{1,2})x(\d{1,2})(?!\d)", name):
        rows, cols = int(named[1]), int(named[2])
        unlike = max(down.get(rows, 0), across.get(cols, 0))
        if rows * cols > 1 and not (height % rows or width % cols) and unlike < _PLAIN:
            return Tiling.even(picture, rows, cols)
    rows, row_unlike = _period(plane, 0, height, down)
    cols, col_unlike = _period(plane, 1, width, across)
    if max(row_unlike, col_unlike) < _TWO_AXES:
        return Tiling.even(picture, rows, cols)
    if col_unlike < _ONE_AXIS and cols > 2:
        return Tiling.even(picture, 1, cols)
    if row_unlike < _ONE_AXIS and rows > 2:
        return Tiling.even(picture, rows, 1)
    return None


def _as_quilt(picture: NDArray[Any], plain: Tiling) -> Tiling:
    """The tiles as one line of views, from the bottom left one, if that explains the similarity of
    tiles better than a grid.
    """
    rows, cols = plain.shape
    if min(rows, cols) < 2:
        return plain
    likely, near = likeliest(
        lambda at: plane_of(plain.cut(picture, *divmod(at, cols))),
        [True] * rows * cols,
        [Running(rows=rows, cols=cols), Running(rows=1, cols=rows * cols, upwards=cols)],
    )
    doubt = f"one line of {rows * cols} views (--set scene.layout=quilt), or {rows}x{cols} (mosaic)"
    return attrs.evolve(plain, quilt=likely.rows == 1, doubt=doubt if near else plain.doubt)


def last_picture(load: Callable[[int], NDArray[Any]]) -> Callable[[int], NDArray[Any]]:
    """load, which returns a picture by frame number, with a thread-safe cache of one picture."""
    lock = threading.Lock()
    cached = lru_cache(maxsize=1)(load)

    def read(frame: int) -> NDArray[Any]:
        with lock:
            return cached(frame)

    return read


def halves(picture: NDArray[Any], above: bool) -> tuple[NDArray[Any], NDArray[Any]]:
    """The left and the right half of a picture, or the upper and the lower one."""
    height, width = picture.shape[0] // 2, picture.shape[1] // 2
    if above:
        return picture[:height], picture[height : 2 * height]
    return picture[:, :width], picture[:, width : 2 * width]


def is_film(listing: Listing) -> bool:
    """Whether the scene is a video file."""
    return listing.is_file and listing.names[0].lower().endswith(VIDEOS)


def single_picture(listing: Listing) -> Path | None:
    """The picture of a scene of one picture: the given file, or the only picture of the folder."""
    pictures = listing.pictures()
    return listing.file(pictures[0]) if len(pictures) == 1 else None


def require_picture(listing: Listing) -> Path:
    """As `single_picture`. Raises UserError if there is none, or more than one."""
    path = single_picture(listing)
    if path is None:
        raise UserError(
            f"{listing.path}: contains {len(listing.pictures())} pictures, not one",
            "give the file itself, or leave out scene.layout",
        )
    return path


def tiling(
    picture: NDArray[Any], path: Path, scene: config.Scene, quilt: bool = False
) -> Tiling | None:
    """The tiling of the picture at path: from scene.grid or a quilt's name, else detected. quilt:
    the tiles form one line of views; otherwise the pictures decide. Raises UserError if the given
    grid does not divide the picture.
    """
    height, width = picture.shape[:2]
    named = QUILT_NAME.search(path.stem) if quilt else None
    grid = parse_grid(scene.grid) or ((int(named[2]), int(named[1])) if named else None)
    tiles = None if quilt and grid else find_tiles(picture, f"{path.parent.name}/{path.stem}")
    if grid is not None and (tiles is None or tiles.shape != grid):
        rows, cols = grid
        if min(height // rows, width // cols) < MIN_VIEW_PX:
            raise UserError(
                f"{path}: {width}x{height} px in {rows} rows and {cols} columns make tiles of"
                f" {width // cols}x{height // rows} px, too small to show anything",
                "give the grid that was rendered with --set scene.grid=ROWSxCOLS",
            )
        # programs for light-field displays leave a remainder
        tiles = Tiling.even(picture, rows, cols, resized=named is None)
    if tiles is None or quilt or grid is not None or scene.layout == "mosaic":  # set by the user
        return tiles and attrs.evolve(tiles, quilt=quilt, doubt="")
    return _as_quilt(picture, tiles)
