"""Grids of views: one picture file per view, by the numbers in the names (a note lists unused
files); and pictures of many tiles, one view each: where the tiles are, and whether they form a
grid or one line, as in a quilt.
"""

import re
import threading
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import MAX_DECODING_BYTES, Header, open_header, read_picture, small_grey
from lfpipe.scene.layouts._likeness import (
    MIN_VIEW_PX,
    Running,
    find_columns,
    find_tiles,
    likeliest,
    plane_of,
)
from lfpipe.scene.layouts._names import MAX_SIDE, NumberedNames, placed, read_names, spaced
from lfpipe.scene.layouts._stated import time_of_photograph
from lfpipe.scene.optical_flow import LOOK_PX
from lfpipe.scene.source import MAX_FILES, VIDEOS, GridTransform, Listing, SceneSource, ViewIndex

FULL = 0.75  # minimum share of a grid that has views
GRID_REMEDY = (
    "state the grid: `lfpipe scene describe FOLDER --grid ROWSxCOLS`; or name the views"
    " view_ROW_COLUMN.png, or give one picture by its own path"
)


def parse_grid(text: str) -> ViewIndex | None:
    """`scene.grid` as (rows, cols); None if empty. Raises UserError."""
    if not text:
        return None
    numbers = re.fullmatch(r"\s*(\d{1,4})\s*[xX×]\s*(\d{1,4})\s*", text)
    if not numbers or int(numbers[1]) * int(numbers[2]) == 0:
        raise UserError(
            f"scene.grid: {text!r} is not ROWSxCOLS", "give two whole numbers, as in 9x9"
        )
    require_grid(int(numbers[1]), int(numbers[2]), "scene.grid")
    return int(numbers[1]), int(numbers[2])


def require_grid(rows: int, cols: int, what: str) -> None:
    """Raises UserError if the grid is too large. what: its source, for the message."""
    if not (1 <= rows <= MAX_SIDE and 1 <= cols <= MAX_SIDE and rows * cols <= MAX_FILES):
        raise UserError(
            f"{what}: the grid has {rows}x{cols} views; at most {MAX_SIDE} along a side and"
            f" {MAX_FILES} together are expected",
            "give the true one with --set scene.grid=ROWSxCOLS",
        )


def require_view(height: int, width: int, sample_bytes: int, what: str) -> None:
    """Raises UserError if views are too large or too small. what: source of the size, for the
    message.
    """
    large = height * width * 3 * sample_bytes > MAX_DECODING_BYTES
    if large or min(height, width) < MIN_VIEW_PX:
        raise UserError(
            f"{what}: views have {width}x{height} px; a side has at least {MIN_VIEW_PX}, and a view"
            f" at most {MAX_DECODING_BYTES / 1e6:.0f} MB",
            "save the array with the axes (rows, columns, height, width, planes), or export it with"
            " smaller views",
        )


def some(names: Sequence[str], most: int = 4) -> str:
    """The first names of a list, and the number of the others."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def files_source(
    layout: str,
    listing: Listing,
    views: Mapping[ViewIndex, str],
    shape: ViewIndex,
    headers: Mapping[str, Header] | None = None,
    **more: Any,
) -> SceneSource:
    """A SceneSource that reads one picture file per view; indices without a name are missing views.
    Size and bit depth are those of the middle view; raises UserError for a view that differs.
    headers: by name, if known; more: further fields of SceneSource.
    """
    files = {place: listing.file(name) for place, name in views.items()}
    middle = min(
        files,
        key=lambda place: (abs(place[0] - shape[0] // 2) + abs(place[1] - shape[1] // 2), place),
    )
    headers = headers or {name: open_header(listing.file(name)) for name in views.values()}
    first = headers[views[middle]]
    for what in ("size", "bits"):
        kinds = {name: getattr(headers[name], what) for name in views.values()}
        usual = Counter(kinds.values()).most_common(1)[0][0]
        for place, name in views.items():
            if kinds[name] != usual:
                like = next(name for name, kind in kinds.items() if kind == usual)
                raise UserError(
                    f"{files[place]}: has {kinds[name]}, but {like} has {usual}",
                    "export it again: every view of a light field has the same size and depth",
                )

    def read(frame: int, row: int, col: int) -> NDArray[Any]:
        pixels, _ = read_picture(files[row, col])
        if pixels.shape[:2] != (first.height_px, first.width_px):
            raise UserError(
                f"{files[row, col]}: changed while it was read",
                "try again once the files are complete",
            )
        return pixels

    missing = frozenset(place for place in np.ndindex(shape) if place not in files)
    return SceneSource(
        layout=layout,
        path=listing.path,
        files=tuple(files[place] for place in sorted(files)),
        rows=shape[0],
        cols=shape[1],
        read=read,
        height_px=first.height_px,
        width_px=first.width_px,
        max_value=first.max_value,
        missing=missing,
        small=lambda row, col, most_px: small_grey(files[row, col], most_px),
        **more,
    )


def named_views(listing: Listing) -> NumberedNames | None:
    """The interpretation of the names of a folder's pictures; None if they are not numbered."""
    # of a stereo camera's pairs and their flat twins, the pairs
    return read_names(
        tuple(sorted(listing.pictures(), key=lambda n: not n.lower().endswith(".mpo")))
    )


def _headers(listing: Listing, names: Collection[str]) -> tuple[dict[str, Header], set[str]]:
    """The headers of pictures, and the names of the few whose size differs from the rest. Raises
    UserError if they are scenes of their own.
    """
    headers = {name: open_header(listing.file(name)) for name in names}
    if pairs := [name for name, header in headers.items() if header.holds_pair]:
        raise UserError(
            f"{listing.path}: {len(pairs)} files hold a stereo pair each: {some(pairs)}",
            f"give one of them: {listing.file(pairs[0])}; `lfpipe up` shows the whole folder, one"
            " after the other",
        )
    usual, count = Counter(header.size for header in headers.values()).most_common(1)[0]
    return headers, {
        name
        for name, header in headers.items()
        if header.size != usual and 2 * count > len(headers)
    }


def describe_views(layout: str, listing: Listing, scene: config.Scene, runs: bool) -> SceneSource:
    """The scene of a folder with one picture per view. runs: its names count, whatever rows and
    columns they contain, as for a grid that is not theirs.

    Raises UserError.
    """
    numbered = named_views(listing)
    if numbered is None:
        raise UserError(
            f"{listing.path}: {len(listing.pictures())} pictures whose names do not differ in"
            " numbers",
            GRID_REMEDY,
        )
    headers, odd = _headers(listing, numbered.views.values())
    if odd:
        usual = tuple(name for name in listing.pictures() if name not in odd)
        numbered = read_names(usual) or numbered
    if not runs and numbered.runs:
        raise UserError(
            f"{listing.path}: the names contain one running number, not row and column",
            "use --set scene.layout=numbered",
        )
    grid = parse_grid(scene.grid)
    if runs or grid not in (None, (numbered.rows, numbered.cols)):
        run, views, note = _laid_out(listing, numbered, grid)
        doubt = run.doubt
        numbered = attrs.evolve(numbered, views=views, rows=run.rows, cols=run.cols)
        return _views_source(layout, listing, numbered, headers, note, certain=False, doubt=doubt)
    return _views_source(layout, listing, numbered, headers, certain=False)


def _laid_out(
    listing: Listing, numbered: NumberedNames, grid: ViewIndex | None
) -> tuple[Running, dict[ViewIndex, str], str]:
    """How views of a running number fill their grid, their places, and a note on how that was
    detected. Raises UserError.
    """
    if numbered.runs:
        names = {col: name for (_, col), name in numbered.views.items()}
    else:  # row and column, which the user's layout ignores
        names = dict(enumerate(numbered.views[place] for place in sorted(numbered.views)))

    def filled(names: Mapping[int, str]) -> Running | None:
        return find_columns(
            lambda position: small_grey(listing.file(names[position]), LOOK_PX),
            [at in names for at in range(max(names) + 1)],
            grid,
        )

    run = filled(names)
    if run is None:
        raise misfit(str(listing.path), max(names) + 1, grid)
    note = ""
    if not grid and (run.rows == 1 or run.doubt):
        times = {
            name: time
            for name in names.values()
            if (time := time_of_photograph(listing.file(name)))
        }
        by_time = sorted(names.values(), key=lambda name: times.get(name, ""))
        if len(times) == len(names) and by_time != list(names.values()):
            names = dict(enumerate(by_time))
            run = filled(names) or run
            note = (
                f"in the order of their times, {some(by_time)}"
                " (--set scene.grid=ROWSxCOLS takes that of their names); "
            )
    views = {run.index(position): name for position, name in names.items()}
    return run, views, note + described_run(run, grid)


def misfit(what: str, count: int, grid: ViewIndex | None) -> UserError:
    """The error for a number of views that does not fill the user's grid."""
    rows, cols = grid or (1, count)
    return UserError(
        f"{what}: {count} views do not fill {rows}x{cols}",
        "correct --set scene.grid=ROWSxCOLS, or leave it out to have the grid detected",
    )


def described_run(run: Running, grid: ViewIndex | None) -> str:
    """A description of how numbered views fill their grid, for people."""
    why = (
        "set by scene.grid"
        if grid
        else "from the likeness of the pictures; --set scene.grid=ROWSxCOLS overrides it"
    )
    return f"the numbered views form {run.rows}x{run.cols}: {why}"


def placed_views(
    layout: str,
    listing: Listing,
    places: Mapping[str, ViewIndex],
    shape: ViewIndex | None = None,
    **more: Any,
) -> SceneSource:
    """The scene of pictures whose names contain row and column. shape: the grid; if None, numbers
    may start anywhere and increase in equal steps (rows 0, 4, 8). more: further fields of
    SceneSource. Raises UserError.
    """
    headers, odd = _headers(listing, list(places))
    (top, down, rows), (left, across, cols) = (
        spaced([place[axis] for place in places.values()]) for axis in (0, 1)
    )
    if shape:
        (top, down, rows), (left, across, cols) = (0, 1, shape[0]), (0, 1, shape[1])
    names = [name for name in places if name not in odd]
    by_row = [(places[name][0] - top) // down for name in names]
    by_col = [(places[name][1] - left) // across for name in names]
    return _views_source(
        layout, listing, placed(names, by_row, by_col, (rows, cols)), headers, **more
    )


def _views_source(
    layout: str,
    listing: Listing,
    numbered: NumberedNames,
    headers: Mapping[str, Header],
    note: str = "",
    doubt: str = "",
    **more: Any,
) -> SceneSource:
    """The scene of views by grid index, with a note of unused pictures. Raises UserError if too
    many indices have no view.
    """
    rows, cols, views = numbered.rows, numbered.cols, numbered.views
    require_grid(rows, cols, str(listing.path))
    holes = [place for place in np.ndindex(rows, cols) if place not in views]
    # the packer copies missing views from their neighbours
    if len(views) < FULL * rows * cols:
        raise UserError(
            f"{listing.path}: the names span {rows}x{cols} views, but there are {len(views)} files",
            "give a folder with a whole row or a whole grid of one scene",
        )
    notes = [note] if note else []
    if holes:
        where = some([f"row {row} column {col}" for row, col in holes])
        notes.append(f"{len(holes)} of {rows}x{cols} views missing, copied from others: {where}")
    used = set(views.values())
    names = listing.pictures()
    if unused := [
        f"{name} ({headers[name].size})" if name in headers else name
        for name in names
        if name not in used
    ]:
        notes.append(f"{len(used)} of {len(names)} files used; the others are {some(unused)}")
    return files_source(
        layout,
        listing,
        views,
        (rows, cols),
        headers,
        doubt=doubt,
        notes=tuple(notes),
        **more,
    )


def coordinate_turn(camera_positions: NDArray[np.float64]) -> GridTransform | None:
    """The transform to canonical order from camera positions (rows, cols, 2), (down, right) in file
    order, NaN where unknown; None if they do not determine it. Along each index axis, the
    coordinate with the largest mean step decides.
    """
    by_row, by_col = (
        np.ma.masked_invalid(camera_positions).mean(axis=axis).filled(np.nan) for axis in (1, 0)
    )
    down_by_row, right_by_row = by_row[-1] - by_row[0]
    down_by_col, right_by_col = by_col[-1] - by_col[0]
    straight, crossed = abs(down_by_row) + abs(right_by_col), abs(right_by_row) + abs(down_by_col)
    if not abs(straight - crossed) > 0:  # equal, or unknown
        return None
    if straight > crossed:
        return GridTransform(rows=bool(down_by_row < 0), cols=bool(right_by_col < 0))
    return GridTransform(rows=bool(down_by_col < 0), cols=bool(right_by_row < 0), transpose=True)


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
    shape = None if quilt and grid else find_tiles(picture, f"{path.parent.name}/{path.stem}")
    tiles = shape and Tiling.even(picture, *shape)
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
