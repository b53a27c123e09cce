"""One picture file per view: maps the numbers in the names to a grid of views. A note lists unused
files.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import MAX_DECODING_BYTES, Header, open_header, read_picture, small_grey
from lfpipe.scene.files import MAX_FILES, Listing, stem_of
from lfpipe.scene.layouts._names import MAX_SIDE, NumberedNames, placed, read_names, spaced
from lfpipe.scene.layouts._order import motion_order
from lfpipe.scene.layouts._running import MAX_PICTURES, Running, lay_out, reduced
from lfpipe.scene.source import GridTransform, SceneSource, ViewIndex

LOSSY = (".jpg", ".jpeg", ".webp", ".avif", ".gif")
MIN_VIEW_PX = 12  # side of a view: a smaller one shows nothing
_SMALL_PX = 256  # side of pictures compared to find the columns of a running number
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
    if min(height, width) < MIN_VIEW_PX:
        raise UserError(
            f"{what}: views have {width}x{height} px; a side has at least {MIN_VIEW_PX}",
            "save the array with the axes (rows, columns, height, width, planes)",
        )
    if height * width * 3 * sample_bytes > MAX_DECODING_BYTES:
        raise UserError(
            f"{what}: views have {width}x{height} px; at most {MAX_DECODING_BYTES / 1e6:.0f} MB"
            " each are expected",
            "export it with smaller views",
        )


def true_max(values: list[int], full: int) -> int:
    """The full-scale value of 16-bit files that may hold 10, 12 or 14 bits, by the largest value of
    some views.
    """
    return (
        full
        if full != 65535
        else next((top for top in (1023, 4095, 16383) if max(values) <= top), full)
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
    full = first.max_value
    if full == 65535:
        full = true_max(
            [
                int(read_picture(files[place])[0].max())
                for place in {min(files), middle, max(files)}
            ],
            full,
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
        max_value=full,
        missing=missing,
        small=(
            None
            if full != first.max_value
            else lambda row, col, most_px: small_grey(files[row, col], most_px)
        ),
        **more,
    )


@lru_cache(maxsize=2)
def _one_per_stem(listing: Listing) -> tuple[str, ...]:
    """The pictures of a folder, one per stem: of a view in several formats, the stereo pair, then
    the one in colour, then the lossless one.
    """
    stems: defaultdict[str, list[str]] = defaultdict(list)
    for name in listing.pictures():
        stems[stem_of(name)].append(name)

    def rank(name: str) -> tuple[bool, bool, bool]:
        try:
            header = open_header(listing.file(name))
            return not header.holds_pair, header.grey, name.lower().endswith(LOSSY)
        except UserError:
            return True, True, True

    return tuple(min(names, key=rank) if len(names) > 1 else names[0] for names in stems.values())


def named_views(listing: Listing) -> NumberedNames | None:
    """The interpretation of the names of a folder's pictures; None if they are not numbered."""
    return read_names(_one_per_stem(listing))


def _headers(listing: Listing, names: Sequence[str]) -> tuple[dict[str, Header], set[str]]:
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
    """The scene of a folder with one picture per view. runs: the names contain one running number,
    not row and column.

    Raises UserError.
    """
    numbered = named_views(listing)
    if numbered is None:
        what = (
            f"{listing.path}: {len(listing.pictures())} pictures whose names do not differ in"
            " numbers"
        )
        raise UserError(what, GRID_REMEDY)
    headers, odd = _headers(listing, list(numbered.views.values()))
    if odd:
        numbered = (
            read_names(tuple(name for name in _one_per_stem(listing) if name not in odd))
            or numbered
        )
    if runs and not numbered.runs:
        line = {
            (0, position): name for position, (_, name) in enumerate(sorted(numbered.views.items()))
        }
        numbered = attrs.evolve(numbered, views=line, rows=1, cols=len(line), runs=True, doubt="")
    if not runs and numbered.runs:
        what = f"{listing.path}: the names contain one running number, not row and column"
        raise UserError(what, "use --set scene.layout=numbered")
    grid = parse_grid(scene.grid)
    note = ""
    if not runs and grid not in (None, (numbered.rows, numbered.cols)):
        wrong = (
            f"the names give a grid of {numbered.rows}x{numbered.cols}, but scene.grid is"
            f" {scene.grid}"
        )
        raise UserError(
            f"{listing.path}: {wrong}",
            "take the names in order with --set scene.layout=numbered"
            if grid is not None and grid[0] * grid[1] == len(numbered.views)
            else "leave out scene.grid",
        )
    if runs and not numbered.clashes:
        numbered, note = _laid_out(listing, numbered, grid)
    return _views_source(layout, listing, numbered, headers, note, certain=False)


def _laid_out(
    listing: Listing, numbered: NumberedNames, grid: ViewIndex | None
) -> tuple[NumberedNames, str]:
    """Views of a running number in their grid, with a note on how that was found. Raises
    UserError.
    """
    names = {col: name for (_, col), name in numbered.views.items()}

    @cache
    def read(position: int) -> NDArray[np.uint8]:
        return reduced(small_grey(listing.file(names[position]), _SMALL_PX**2), _SMALL_PX)

    sizes = Counter(listing.file(name).stat().st_size for name in names.values())
    possible_copies = [
        position
        for position in sorted(names)
        if len(names) <= MAX_PICTURES or sizes[listing.file(names[position]).stat().st_size] > 1
    ]
    present = [position in names for position in range(numbered.cols)]
    run, places, again = lay_out(read, present, grid, possible_copies)
    if run is None:
        raise misfit(str(listing.path), len(places), grid)
    kept = sorted(places)
    order, astray = motion_order(read, kept) if not grid and len(kept) > 2 else ([], None)
    if order:  # a line, whatever the likeness of its pictures says
        run = Running(rows=1, cols=run.rows * run.cols)
    note = described_run(run, grid)
    if order not in ([], kept):
        run = attrs.evolve(run, cols=len(order))
        places = {position: place for place, position in enumerate(order)}
        note = (
            "the views are in the order that the motion between them proves, not in that of their"
            f" names: {some([names[position] for position in order])}"
        )
    views = {run.index(place): names[position] for position, place in places.items()}
    twice = [
        f"{names[late]} is the same picture as {names[early]}" for late, early in again.items()
    ]
    doubt = run.doubt
    if astray is not None and run.rows == 1:
        doubt = (
            f"the order of the views: {names[astray]} is not between the two beside it"
            f" (--set scene.grid=1x{run.cols} takes the names' order)"
        )
    return attrs.evolve(
        numbered, views=views, rows=run.rows, cols=run.cols, doubt=doubt
    ), "; ".join([*twice, note])


def misfit(what: str, count: int, grid: ViewIndex | None) -> UserError:
    """The error for a number of views that does not fill the user's grid."""
    rows, cols = grid or (1, count)
    return UserError(
        f"{what}: {count} views do not fill {rows}x{cols}",
        "correct --set scene.grid=ROWSxCOLS, or leave it out to have the grid detected",
    )


def described_run(run: Running, grid: ViewIndex | None) -> str:
    """A description of how numbered views fill their grid, for people."""
    how = f"{run.rows}x{run.cols}" + (", every other row backwards" if run.snake else "")
    why = (
        "set by scene.grid"
        if grid
        else "from the likeness of the pictures; --set scene.grid=ROWSxCOLS overrides it"
    )
    return f"the numbered views form {how}: {why}"


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
    **more: Any,
) -> SceneSource:
    """The scene of views by grid index, with a note of unused pictures. Raises UserError if two
    views have the same index, or too many indices have no view.
    """
    rows, cols, views = numbered.rows, numbered.cols, numbered.views
    if numbered.clashes:
        first, second = numbered.clashes[0]
        pairs = len(numbered.clashes) - 1
        remedy = (
            f"move {some([name for _, name in numbered.clashes])} away, or name the views"
            " view_ROW_COLUMN.png"
        )
        others = f", and so are {pairs} more pairs" if pairs else ""
        raise UserError(f"{listing.path}: {first} and {second} are the same view{others}", remedy)
    require_grid(rows, cols, str(listing.path))
    holes = [place for place in np.ndindex(rows, cols) if place not in views]
    # the packer fills in missing views from their neighbours
    if len(holes) > 0.25 * rows * cols:
        raise UserError(
            f"{listing.path}: the names span {rows}x{cols} views, but there are {len(views)} files",
            "give a folder with a whole row or a whole grid of one scene",
        )
    notes = [note] if note else []
    if holes:
        where = some([f"row {row} column {col}" for row, col in holes])
        notes.append(f"{len(holes)} of {rows}x{cols} views missing, filled in from others: {where}")
    used = set(views.values())
    names = listing.pictures()
    sizes = {headers[name].size for name in used}
    odd = {
        name: f"{name} ({header.size})"
        for name, header in headers.items()
        if header.size not in sizes
    }
    if unused := [odd.get(name, name) for name in names if name not in used]:
        notes.append(f"{len(used)} of {len(names)} files used; the others are {some(unused)}")
    return files_source(
        layout,
        listing,
        views,
        (rows, cols),
        headers,
        doubt=numbered.doubt,
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
