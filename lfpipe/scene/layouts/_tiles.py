"""Pictures of many tiles, one view each: finds the tiles by lines of one colour between them or by
the similarity of neighbours, and decides whether they form a grid or one line, as in a quilt.
"""

import re
import threading
from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import read_picture
from lfpipe.scene.files import VIDEOS, Listing, stem_of
from lfpipe.scene.layouts._candidates import Candidate, ranked
from lfpipe.scene.layouts._grid import LOSSY, MIN_VIEW_PX, parse_grid
from lfpipe.scene.layouts._running import Running, likeliest, reduced

# Looking Glass: columns, rows, aspect
QUILT_NAME = re.compile(r"_qs([1-9][0-9]?)x([1-9][0-9]?)(?:a[\d.]+)?", re.IGNORECASE)
_SAME_PICTURE = 0.98  # correlation of two files of one picture
_LOOK_PX = 32  # side of pictures to compare
_FROM_THE_TOP = "whether its first view is the top left tile: a quilt begins at the bottom left"
MAX_TILES = 64  # along one side
_GLANCE_PX = 1024  # longer side of the reduced picture in which tiles are detected
# limits of `_unlike` for neighbouring tiles; above the last, there are no tiles
_TWO_AXES, _ONE_AXIS, _PLAIN = 0.5, 0.2, 0.8
_SEAM = 0.1  # share of a tile's lines that may change more than its borders
_ALIKE = 0.03  # differences by which tiles are as much alike as tiles of tiles
# grey levels from the colour of lines (JPEG blurs them), and share of a line
_LINE_LEVELS = (4, 16, 48)
_LINE_SHARE = 0.98
_LINE_SAMPLES = 64  # along a line
_SOFT_PX = 2  # variation in size of lines and tiles if lines have soft edges


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
    down: bool = False  # a quilt from the top left tile, downwards
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
            row = row if self.down else len(self.tops) - 1 - row
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


def _period(grey: NDArray[np.float32], axis: int, full_px: int) -> tuple[int, float]:
    """The number of tiles with the most similar neighbours along an axis, and their difference;
    (1, 1.0) if there is none. A number that does not divide the side must have seams; tiles of
    tiles are no tiles.
    """
    fits = {
        n: u
        for n, u in _unlike(grey, axis).items()
        if full_px // n >= MIN_VIEW_PX
        and (full_px % n == 0 or (u < _TWO_AXES and _seams(grey, axis, n)))
    }
    best = min(fits, key=lambda n: fits[n], default=1)
    best = max((n for n in fits if n % best == 0 and fits[n] < fits[best] + _ALIKE), default=best)
    return best, fits.get(best, 1.0)


def _between_lines(picture: NDArray[Any]) -> list[tuple[int, int]]:
    """(first, last + 1) of the rows between lines of one colour, if these divide the picture
    evenly; else all rows as one range.
    """
    height, width = picture.shape[:2]
    some = np.asarray(picture[:, :: max(1, width // _LINE_SAMPLES)], np.float32).reshape(
        height, -1, picture[0, 0].size
    )
    some *= np.float32(255 / max(1.0, float(some.max())))
    middle = np.median(some, axis=1, keepdims=True)
    colour = middle[np.abs(some - middle).max(axis=2).mean(axis=1).argmin()]
    off = np.abs(some - colour).max(axis=2)
    tiles = [(0, height)]
    for levels in _LINE_LEVELS:
        runs = _runs((off < levels).mean(axis=1) > _LINE_SHARE)
        if len(runs) == 1 == len(tiles) or (len(runs) > len(tiles) and _even(runs, height)):
            least = min(last - first for first, last in runs)  # soft edges of a line belong to it
            tiles = [(first, first + least) for first, _ in runs]
    return tiles


def _runs(plain: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(first, last + 1) of the ranges between plain lines."""
    edges = np.flatnonzero(np.diff(np.concatenate(([True], plain, [True])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _even(runs: list[tuple[int, int]], whole_px: int) -> bool:
    """Whether all runs have one size, and all lines between them a smaller one."""
    sizes, gaps = [last - first for first, last in runs], [b[0] - a[1] for a, b in pairwise(runs)]
    if len(runs) > MAX_TILES or min(sizes) < MIN_VIEW_PX or max(sizes) - min(sizes) > _SOFT_PX:
        return False
    around = runs[0][0] + whole_px - runs[-1][1]
    # plain lines of a tile's background belong to the tile
    margins = 0 < around <= 1.5 * min(gaps)
    return not margins and max(gaps) - min(gaps) <= _SOFT_PX and 4 * max(gaps) < min(sizes)


def _by_lines(picture: NDArray[Any]) -> Tiling | None:
    """The tiles of a picture with lines between them, as in contact sheets and plots; None without
    such lines.
    """
    down = _between_lines(picture)
    across = _between_lines(picture.swapaxes(0, 1))
    if len(down) * len(across) < 3:  # one or two framed photographs are not a mosaic
        return None
    top, bottom = down[0]
    left, right = across[0]
    return Tiling(
        tops=tuple(first for first, _ in down),
        lefts=tuple(first for first, _ in across),
        height_px=bottom - top,
        width_px=right - left,
    )


def find_tiles(picture: NDArray[Any], name: str = "") -> Tiling | None:
    """The tiles of a picture, or None: a mosaic has lines between its tiles, or nearly repeats
    itself after one tile.

    name: of the file or folder; a grid in the name (9x9) is used unless the picture contradicts it.
    """
    lined = _by_lines(picture)
    if lined is not None:
        return lined
    height, width = picture.shape[:2]
    order = ranked(f"the tiles of {width}x{height} px", list(_candidates(picture, name)))
    return order[0].value if order else None


def _candidates(picture: NDArray[Any], name: str) -> Iterator[Candidate[Tiling]]:
    """A grid in the name, and grids whose neighbouring tiles are alike: the name ranks first, then
    similarity along both axes, then along one.
    """
    height, width = picture.shape[:2]
    small = reduced(picture, _GLANCE_PX)  # reducing a single plane would copy it
    plane = (small if small.ndim == 2 else small[..., 1]).astype(np.float32)
    down, across = _unlike(plane, 0), _unlike(plane, 1)
    for named in re.finditer(r"(?<!\d)(\d{1,2})x(\d{1,2})(?!\d)", name):
        rows, cols = int(named[1]), int(named[2])
        unlike = max(down.get(rows, 0), across.get(cols, 0))
        if rows * cols > 1 and not (height % rows or width % cols) and unlike < _PLAIN:
            yield _candidate("the name", Tiling.even(picture, rows, cols), 2, unlike)
    (rows, row_unlike), (cols, col_unlike) = _period(plane, 0, height), _period(plane, 1, width)
    unlike = max(row_unlike, col_unlike)
    grid = Tiling.even(picture, rows, cols)
    strip = None
    if col_unlike < _ONE_AXIS and cols > 2:
        strip = Tiling.even(picture, 1, cols)
    elif row_unlike < _ONE_AXIS and rows > 2:
        strip = Tiling.even(picture, rows, 1)
    if unlike < _TWO_AXES:
        yield _candidate("likeness along both axes", grid, 1, unlike)
    elif strip is not None:
        yield _candidate("likeness along one axis", strip, 0, min(row_unlike, col_unlike))
        if unlike <= _PLAIN:
            either = f"{rows}x{cols}, or {strip.shape[0]}x{strip.shape[1]}"
            yield _candidate(
                "likeness along both axes",
                attrs.evolve(grid, doubt=f"the tiles: {either} (--set scene.grid=ROWSxCOLS)"),
                1,
                unlike,
            )


def _candidate(why: str, tiling: Tiling, rank: int, unlike: float) -> Candidate[Tiling]:
    """unlike: difference of neighbouring tiles, as `dip`, less than 1."""
    return Candidate(
        what=f"{tiling.shape[0]}x{tiling.shape[1]}, by {why}",
        score=rank + 1 - unlike,
        value=tiling,
        measures={"neighbours unlike": unlike},
    )


def _as_quilt(picture: NDArray[Any], plain: Tiling) -> Tiling:
    """The tiles as one line of views, from the bottom left (or the top left) one, if that explains
    the similarity of tiles better than a grid.
    """
    rows, cols = plain.shape
    if min(rows, cols) < 2:
        return plain
    likely = likeliest(
        lambda at: plane_of(plain.cut(picture, *divmod(at, cols))),
        [True] * rows * cols,
        [
            Running(rows=rows, cols=cols),
            Running(rows=1, cols=rows * cols, upwards=cols),
            Running(rows=1, cols=rows * cols),
        ],
    )
    doubt = f"one line of {rows * cols} views (--set scene.layout=quilt), or {rows}x{cols} (mosaic)"
    if likely.run.rows > 1:
        return plain if likely.clear else attrs.evolve(plain, doubt=doubt)
    down = not likely.run.upwards
    if likely.clear:
        doubt = _FROM_THE_TOP if down else ""
    return attrs.evolve(plain, quilt=True, down=down, doubt=doubt)


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


@lru_cache(maxsize=8)
def glance(path: Path) -> NDArray[Any]:
    """A picture, reduced to 128x128 values of 8 bits. Raises UserError."""
    picture, full = read_picture(path)
    small = cv2.resize(picture, (128, 128), interpolation=cv2.INTER_AREA)
    return small if full == 255 else np.asarray(small * (255 / max(1, int(small.max()))), np.uint8)


def likeness(a: Path, b: Path) -> float:
    """Correlation of two pictures, heavily reduced and in grey; 0 if one is plain or unreadable, or
    only one has colour.
    """
    try:
        looks = [
            cv2.resize(glance(path), (_LOOK_PX, _LOOK_PX), interpolation=cv2.INTER_AREA)
            for path in (a, b)
        ]
    except UserError:
        return 0.0
    greys = [(look if look.ndim == 2 else look.mean(axis=2)).ravel() for look in looks]
    if looks[0].ndim != looks[1].ndim or min(float(grey.std()) for grey in greys) < 1:
        return 0.0
    return float(np.corrcoef(greys[0], greys[1])[0, 1])


def one_picture_twice(listing: Listing) -> str | None:
    """The lossless one of two files with the same stem and picture (moon.jpg, moon.png); None for
    anything else.
    """
    names = listing.pictures()
    if len(names) != 2 or stem_of(names[0]).lower() != stem_of(names[1]).lower():
        return None
    same = likeness(*(listing.file(name) for name in names)) > _SAME_PICTURE
    return min(names, key=lambda name: name.lower().endswith(LOSSY)) if same else None


def single_picture(listing: Listing) -> Path | None:
    """The picture of a scene of one picture: the given file, or the only picture of the folder."""
    pictures = listing.pictures()
    name = pictures[0] if len(pictures) == 1 else one_picture_twice(listing)
    return listing.file(name) if name else None


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
