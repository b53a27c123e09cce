"""One picture file per view: from the numbers in the names to a grid of views, with a word on every file that is not used."""

import logging
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import Header, open_header, small_grey
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import LOSSY, files_source, parse_grid, require_grid
from lfpipe.scene.layouts._names import NumberedNames, read_names
from lfpipe.scene.layouts._running import find_columns
from lfpipe.scene.source import SceneSource, ViewIndex

_MADE_SHARE = 0.25  # of a grid that may be missing: those views are made from their neighbours
_SMALL_PX = 96 * 128  # of pictures that the columns of a running number follow from
_MAX_CELLS = 4000  # of a grid with holes
_RENAME = "name the views view_ROW_COLUMN.png, or give one picture by its own path"
_log = logging.getLogger(__name__)


@attrs.frozen
class GridViews:
    """Views by place in a grid, and notes for people."""

    views: dict[ViewIndex, str]
    rows: int
    cols: int
    doubt: str = ""
    notes: tuple[str, ...] = ()


def some(names: Sequence[str], most: int = 4) -> str:
    """The first names of a list, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


@lru_cache(maxsize=2)
def _one_per_stem(listing: Listing) -> tuple[str, ...]:
    """The pictures of a folder, one of each name: of a view in several formats the one in colour, then the lossless one."""
    stems: defaultdict[str, list[str]] = defaultdict(list)
    for name in listing.pictures():
        stems[name.rpartition(".")[0]].append(name)

    def rank(name: str) -> tuple[bool, bool]:
        try:
            return open_header(listing.file(name)).grey, name.lower().endswith(LOSSY)
        except UserError:
            return True, True

    return tuple(min(names, key=rank) if len(names) > 1 else names[0] for names in stems.values())


def named_views(listing: Listing) -> NumberedNames | None:
    """What the names of a folder's pictures say; None for a file or where they are not numbered."""
    return None if listing.is_file else read_names(_one_per_stem(listing))


def describe_views(layout: str, listing: Listing, scene: config.Scene, runs: bool) -> SceneSource:
    """The scene of a folder with one picture per view. runs: the names contain one running number, not row and column.

    Raises UserError.
    """
    paths = {name: listing.file(name) for name in listing.pictures()}
    numbered = named_views(listing)
    if numbered is None:
        raise UserError(f"{listing.path}: {len(paths)} pictures whose names do not differ in numbers", _RENAME)
    headers = {name: open_header(paths[name]) for name in numbered.views.values()}
    odd = _odd_sizes(headers)
    if odd:
        numbered = read_names(tuple(name for name in _one_per_stem(listing) if name not in odd)) or numbered
    if runs and not numbered.runs:
        line = {(0, position): name for position, (_, name) in enumerate(sorted(numbered.views.items()))}
        numbered = attrs.evolve(numbered, views=line, rows=1, cols=len(line), runs=True)
    if not runs and numbered.runs:
        raise UserError(f"{listing.path}: the names contain one running number, not row and column", "use --layout numbered")
    if numbered.clashes:
        raise _same_view(listing, numbered)
    grid = parse_grid(scene.grid)
    if runs:
        found = _arranged(listing, paths, headers, numbered, grid)
    else:
        found = GridViews(numbered.views, numbered.rows, numbered.cols, numbered.doubt)
        if grid is not None and grid != (found.rows, found.cols):
            wrong = f"{listing.path}: the names give a grid of {found.rows}x{found.cols}, scene.grid says {grid[0]}x{grid[1]}"
            raise UserError(wrong, "leave out --grid; --layout numbered takes names in order")
    if found.rows * found.cols > max(len(found.views), _MAX_CELLS):
        wrong = f"{listing.path}: the names span {found.rows}x{found.cols} views, {len(found.views)} files are there"
        raise UserError(wrong, "give a folder with the views of only one scene")
    spanned, found = found, whole_part(found)
    if 4 * len(found.views) < len(spanned.views):
        wrong = f"{listing.path}: the {len(spanned.views)} views stand scattered in a grid of {spanned.rows}x{spanned.cols}"
        raise UserError(wrong, "give a folder with a whole row or a whole grid of them")
    require_grid(found.rows, found.cols, str(listing.path))
    used, notes = set(found.views.values()), list(found.notes)
    if unused := [f"{name} ({odd[name]})" if name in odd else name for name in paths if name not in used]:
        notes.append(f"{len(used)} of {len(paths)} files used; the others are {some(unused)}")
    _log.debug("%s: %s, %dx%d by the names; %s", listing.path, layout, found.rows, found.cols, notes)
    return files_source(
        layout, listing, {index: paths[name] for index, name in found.views.items()}, found.rows, found.cols, notes=tuple(notes),
        doubt=found.doubt, certain=False, headers={paths[name]: header for name, header in headers.items()},
    )  # fmt: skip


def _same_view(listing: Listing, numbered: NumberedNames) -> UserError:
    """Why names with the same row and column, or number, are refused."""
    (first, second), count = numbered.clashes[0], len(numbered.clashes)
    if count > len(numbered.views):
        what = f"{count} pictures have the same numbers as another one, for example {first} and {second}"
        return UserError(f"{listing.path}: {what}", _RENAME)
    others = f", and so are {count - 1} more pairs" if count > 1 else ""
    remedy = f"move {some([name for _, name in numbered.clashes])} away"
    return UserError(f"{listing.path}: {first} and {second} are the same view{others}", remedy)


def _odd_sizes(headers: Mapping[str, Header]) -> dict[str, str]:
    """Names of the few pictures that have another size than the rest, with their sizes."""
    sizes = {name: f"{header.width_px}x{header.height_px} px" for name, header in headers.items()}
    usual, count = Counter(sizes.values()).most_common(1)[0]
    return {name: size for name, size in sizes.items() if size != usual} if 2 * count > len(headers) else {}


def _arranged(
    listing: Listing, paths: Mapping[str, Path], headers: Mapping[str, Header], numbered: NumberedNames, grid: ViewIndex | None
) -> GridViews:
    """The grid of a running number, by the pictures. Raises UserError."""
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
    views = {index: name for position, name in by_position.items() if (index := run.index(position)) is not None}
    snake = ", every other one backwards" if run.snake else ""
    shape = f"{run.rows} groups of {run.cols}{snake}" if min(run.rows, run.cols) > 1 else "one line"
    why = "as scene.grid says" if grid else "from the likeness of the pictures; --grid ROWSxCOLS overrides it"
    return GridViews(views, run.rows, run.cols, run.doubt, (f"the numbered views form {shape}: {why}",))


def whole_part(found: GridViews) -> GridViews:
    """The grid itself where few views are missing, else the largest whole rectangle within it."""
    views, rows, cols = found.views, found.rows, found.cols
    holes = [(row, col) for row in range(rows) for col in range(cols) if (row, col) not in views]
    if not holes:
        return found
    lonely = [(r, c) for r, c in holes if not {(r, c + 1), (r, c - 1), (r + 1, c), (r - 1, c)} & views.keys()]
    missing = f"{len(holes)} of {rows}x{cols} views missing"
    if len(holes) <= _MADE_SHARE * rows * cols and not lonely:
        where = some([f"row {row} column {col}" for row, col in holes])
        return attrs.evolve(found, notes=(*found.notes, f"{missing}, made from others: {where}"))
    mask = np.zeros((rows, cols), bool)
    for index in views:
        mask[index] = True
    top, left, height, width = _largest_rectangle(mask)
    inside = {(r, c): views[top + r, left + c] for r in range(height) for c in range(width)}
    note = f"{missing}: the whole {height}x{width} views from row {top} column {left} are used"
    return GridViews(inside, height, width, found.doubt, (*found.notes, note))


def _largest_rectangle(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """(top, left, rows, columns) of the largest rectangle that is True; of equals the one with two axes, then the wider one, then
    the one nearest to the middle."""
    best: tuple[tuple[int, bool, int, int], tuple[int, int, int, int]] = ((0, False, 0, 0), (0, 0, 0, 0))
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
                best = max(best, ((low * width, min(low, width) > 1, width, -off), (bottom + 1 - low, left, low, width)))
    return best[1]
