"""One picture file per view: from the numbers in the names to a grid of views, with a word on every file that is not used."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import Header, open_header, small_grey
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import files_source, parse_grid, require_grid
from lfpipe.scene.layouts._names import NumberedNames, read_names
from lfpipe.scene.layouts._running import find_columns
from lfpipe.scene.source import SceneSource, ViewIndex

_MADE_SHARE = 0.25  # of a grid that may be missing: those views are made from their neighbours
_MAX_STRIDE = 8
_SMALL_PX = 96 * 128  # of pictures that the columns of a running number follow from
_MAX_CELLS = 4000  # of a grid with holes


@attrs.frozen
class _Part:
    """A whole or nearly whole grid within an incomplete one, and a note on it."""

    views: dict[ViewIndex, str]
    rows: int
    cols: int
    note: str = ""


def some(names: Sequence[str], most: int = 4) -> str:
    """The first names of a list, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def named_views(listing: Listing) -> NumberedNames | None:
    """What the names of a folder's pictures say; None for a file or where they are not numbered."""
    return None if listing.is_file else read_names(tuple(listing.pictures()))


def describe_views(layout: str, listing: Listing, scene: config.Scene, runs: bool) -> SceneSource:
    """The scene of a folder with one picture per view. runs: the names contain one running number, not row and column.

    Raises UserError.
    """
    paths = {name: listing.file(name) for name in listing.pictures()}
    numbered = read_names(tuple(paths))
    if numbered is None:
        raise UserError(
            f"{listing.path}: {len(paths)} pictures whose names do not differ in numbers",
            "name the views view_ROW_COLUMN.png, or give one picture of the folder by its own path",
        )
    headers = {name: open_header(paths[name]) for name in numbered.views.values()}
    odd = _odd_sizes(headers)
    if odd:
        numbered = read_names(tuple(name for name in paths if name not in odd)) or numbered
    if runs and not numbered.runs:
        numbered = attrs.evolve(numbered, views=dict(_line(numbered)), rows=1, cols=len(numbered.views), runs=True)
    if not runs and numbered.runs:
        raise UserError(f"{listing.path}: the names contain one running number, not row and column", "use --layout numbered")
    if numbered.clashes:
        raise _same_view(listing, numbered)
    grid, doubt, notes = parse_grid(scene.grid), numbered.doubt, []
    if runs:
        views, rows, cols, doubt, note = _arranged(listing, paths, headers, numbered, grid)
        notes.append(note)
    else:
        views, rows, cols = numbered.views, numbered.rows, numbered.cols
        if grid is not None and grid != (rows, cols):
            wrong = f"{listing.path}: the names give a grid of {rows}x{cols}, scene.grid says {grid[0]}x{grid[1]}"
            raise UserError(wrong, "leave out --grid")
    if rows * cols > max(len(views), _MAX_CELLS):
        wrong = f"{listing.path}: the names span {rows}x{cols} views, {len(views)} files are there"
        raise UserError(wrong, "give a folder with the views of only one scene")
    part = whole_part(views, rows, cols)
    require_grid(part.rows, part.cols, str(listing.path))
    used = set(part.views.values())
    unused = [name for name in paths if name not in used]
    if part.note:
        notes.append(part.note)
    if unused:
        sizes = {name: f"{name} ({odd[name]})" if name in odd else name for name in unused}
        notes.append(f"{len(used)} of {len(paths)} files used; the others are {some(list(sizes.values()))}")
    files = {index: paths[name] for index, name in part.views.items()}
    return files_source(
        layout,
        listing,
        files,
        part.rows,
        part.cols,
        notes=tuple(notes),
        doubt=doubt,
        certain=False,
        headers={paths[name]: header for name, header in headers.items()},
    )


def _same_view(listing: Listing, numbered: NumberedNames) -> UserError:
    """Why names with the same row and column, or number, are refused."""
    (first, second), count = numbered.clashes[0], len(numbered.clashes)
    if count > len(numbered.views):
        what = f"{count} pictures have the same numbers as another one, for example {first} and {second}"
        return UserError(f"{listing.path}: {what}", "name the views view_ROW_COLUMN.png, or give one picture by its own path")
    others = f", and so are {count - 1} more pairs" if count > 1 else ""
    remedy = f"move {some([name for _, name in numbered.clashes])} away"
    return UserError(f"{listing.path}: {first} and {second} are the same view{others}", remedy)


def _odd_sizes(headers: Mapping[str, Header]) -> dict[str, str]:
    """Names of the few pictures that have another size than the rest, with their sizes."""
    sizes = {name: f"{header.width_px}x{header.height_px} px" for name, header in headers.items()}
    usual, count = Counter(sizes.values()).most_common(1)[0]
    return {name: size for name, size in sizes.items() if size != usual} if 2 * count > len(headers) else {}


def _line(numbered: NumberedNames) -> list[tuple[ViewIndex, str]]:
    return [((0, position), name) for position, (_, name) in enumerate(sorted(numbered.views.items()))]


def _arranged(
    listing: Listing, paths: Mapping[str, Path], headers: Mapping[str, Header], numbered: NumberedNames, grid: ViewIndex | None
) -> tuple[dict[ViewIndex, str], int, int, str, str]:
    """(views, rows, cols, doubt, note) of a running number, by the pictures. Raises UserError."""
    by_position = {index[1]: name for index, name in numbered.views.items()}

    def read(position: int) -> NDArray[np.uint8]:
        name = by_position[position]
        return small_grey(paths[name], headers[name], _SMALL_PX)

    try:
        run = find_columns(read, [position in by_position for position in range(numbered.cols)], grid)
    except ValueError:
        assert grid is not None
        raise UserError(
            f"{listing.path}: {len(by_position)} views do not make {grid[0]}x{grid[1]}", "leave out --grid to have it detected"
        ) from None
    placed = {index: name for position, name in by_position.items() if (index := run.index(position)) is not None}
    snake = ", every other one backwards" if run.snake else ""
    shape = f"{run.rows} groups of {run.cols}{snake}" if min(run.rows, run.cols) > 1 else "one line"
    why = "as scene.grid says" if grid else "from the likeness of the pictures; --grid ROWSxCOLS overrides it"
    return placed, run.rows, run.cols, run.doubt, f"the numbered views form {shape}: {why}"


def whole_part(views: Mapping[ViewIndex, str], rows: int, cols: int) -> _Part:
    """The grid itself where few views are missing, else the largest whole grid within it."""
    holes = [(row, col) for row in range(rows) for col in range(cols) if (row, col) not in views]
    if not holes:
        return _Part(dict(views), rows, cols)
    lonely = [hole for hole in holes if not _neighboured(hole, views)]
    if len(holes) <= _MADE_SHARE * rows * cols and not lonely:
        where = some([f"row {row} column {col}" for row, col in holes])
        return _Part(dict(views), rows, cols, f"{len(holes)} of {rows}x{cols} views missing, made from others: {where}")
    mask = np.zeros((rows, cols), bool)
    for index in views:
        mask[index] = True
    best: tuple[tuple[int, ...], int, int, int, int, int] = ((0,), 0, 0, 0, 0, 1)  # rank, top, left, rows, columns, stride
    for stride in range(1, min(_MAX_STRIDE if mask.size <= 1000 else 2, max(rows, cols) - 1) + 1):
        for top in range(min(stride, rows)):
            for left in range(min(stride, cols)):
                for rank, box in _rectangles(mask[top::stride, left::stride]):
                    key = (*rank, -stride)
                    if key > best[0]:
                        best = (key, top + box[0] * stride, left + box[1] * stride, box[2], box[3], stride)
    _, top, left, height, width, stride = best
    inside = {(r, c): views[top + r * stride, left + c * stride] for r in range(height) for c in range(width)}
    every = f", every {stride}. one" if stride > 1 else ""
    missing = f"{len(holes)} of {rows}x{cols} views missing"
    note = f"{missing}: the whole {height}x{width} views from row {top} column {left}{every} are used"
    return _Part(inside, height, width, note)


def _neighboured(hole: ViewIndex, views: Collection[ViewIndex]) -> bool:
    return any((hole[0] + down, hole[1] + across) in views for down, across in ((0, 1), (0, -1), (1, 0), (-1, 0)))


def _rectangles(mask: NDArray[np.bool_]) -> list[tuple[tuple[int, ...], tuple[int, int, int, int]]]:
    """Largest whole rectangles of a mask as (rank, (top, left, rows, columns)), one by each row that they end at."""
    found: list[tuple[tuple[int, ...], tuple[int, int, int, int]]] = []
    heights = np.zeros(mask.shape[1], int)
    for bottom, line in enumerate(mask):
        heights = np.where(line, heights + 1, 0)
        for left in range(len(heights)):
            low = 1 << 30
            for right in range(left, len(heights)):
                low = min(low, int(heights[right]))
                if low == 0:
                    break
                width = right - left + 1
                off = abs(2 * left + width - mask.shape[1]) + abs(2 * (bottom + 1) - low - mask.shape[0])
                found.append(((low * width, min(low, width) > 1, width, -off), (bottom + 1 - low, left, low, width)))
    return [max(found)] if found else []
