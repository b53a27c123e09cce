"""Pictures of many tiles, one view each: where they are, and whether they form a grid or one line,
as in a quilt.
"""

import re
import threading
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import attrs
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import VIDEOS, Listing
from lfpipe.scene.layouts._grid import parse_grid
from lfpipe.scene.layouts._likeness import MIN_VIEW_PX, Running, find_tiles, likeliest, plane_of

# Looking Glass: columns, rows, aspect
QUILT_NAME = re.compile(r"_qs([1-9][0-9]?)x([1-9][0-9]?)(?:a[\d.]+)?", re.IGNORECASE)


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
    found = None if quilt and grid else find_tiles(picture, f"{path.parent.name}/{path.stem}")
    tiles = found and Tiling.even(picture, *found)
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
