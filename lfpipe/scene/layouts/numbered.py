"""Numbered pictures, `*_NNN.*`: a grid row by row, column by column or as a snake, or a line of views.

The names do not tell which; neighbouring views are the most alike, and that does.
"""

from __future__ import annotations

import re
from collections import Counter
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import Listing, read_picture
from lfpipe.scene.layouts._grid import files_source, parse_grid, require_whole
from lfpipe.scene.source import SceneSource

NAME = "numbered"
_VIEW = re.compile(r"(.*?)(\d{1,6})(\.\w+)")
_SIDE_PX = 128  # of the small pictures that are compared
_PAIRS = 24  # neighbours looked at per direction


def _views(listing: Listing) -> dict[int, str]:
    """The largest family of names that differ in their last number, by that number."""
    found = {name: match for name in listing.pictures() if (match := _VIEW.fullmatch(name))}
    families = Counter((match[1], match[3].lower()) for match in found.values())
    if not families:
        return {}
    family = max(families, key=lambda key: (families[key], key))
    views: dict[int, str] = {}
    for name, match in found.items():
        if (match[1], match[3].lower()) == family:
            if int(match[2]) in views:
                raise UserError(f"{listing.path}: {views[int(match[2])]} and {name} have one number", "keep one of them")
            views[int(match[2])] = name
    return views


def detect(listing: Listing) -> int | None:
    return 40 if not listing.is_file and len(_views(listing)) > 1 else None


def _place(number: int, cols: int, snake: bool) -> tuple[int, int]:
    """Where the view of a number, counted from 0, stands."""
    row, col = divmod(number, cols)
    return row, cols - 1 - col if snake and row % 2 else col


class _Likeness:
    """How unlike two numbered views are, on small pictures."""

    def __init__(self, listing: Listing, names: list[str]) -> None:
        self._listing, self._names = listing, names

    @lru_cache(maxsize=2048)  # noqa: B019 - lives as long as one call of describe
    def _small(self, number: int) -> NDArray[np.float32]:
        picture, full = read_picture(self._listing.file(self._names[number]))
        scale = min(1.0, _SIDE_PX / max(picture.shape[:2]))
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        return np.asarray(small if small.ndim == 2 else small[..., 1], np.float32) / np.float32(full)

    def mean(self, pairs: list[tuple[int, int]]) -> float:
        """Mean difference over up to _PAIRS of the pairs, evenly chosen; 0 for none."""
        some = pairs[:: max(1, len(pairs) // _PAIRS)]
        values = [
            float(np.mean(np.abs(a - b))) if (a := self._small(i)).shape == (b := self._small(j)).shape else 1.0 for i, j in some
        ]
        return sum(values) / len(values) if values else 0.0


def found_order(unlike: _Likeness, count: int, grid: tuple[int, int] | None) -> tuple[int, int, bool, str]:
    """(rows, cols, snake, why) of `count` numbered views; grid: the user's word on it.

    Among all grids of that many views, the one whose neighbours are most alike in both directions; a line where none is.
    """
    grids = [grid] if grid else [(count // cols, cols) for cols in range(2, count // 2 + 1) if count % cols == 0]
    scores: dict[tuple[int, int, bool], float] = {}
    for rows, cols in grids:
        for snake in (False, True) if min(rows, cols) > 1 else (False,):
            at = {_place(number, cols, snake): number for number in range(count)}
            across = [(at[r, c], at[r, c + 1]) for r in range(rows) for c in range(cols - 1)]
            down = [(at[r, c], at[r + 1, c]) for r in range(rows - 1) for c in range(cols)]
            scores[rows, cols, snake] = unlike.mean(across) + unlike.mean(down)
    if not grid:
        scores[1, count, False] = 2 * unlike.mean([(n, n + 1) for n in range(count - 1)])
    best = min(scores, key=lambda key: (scores[key] * (1.0 if min(key[:2]) > 1 else 1.02), abs(key[0] - key[1]), key[2]))
    backwards = ", every other one backwards" if best[2] else ""
    shape = "a line" if min(best[:2]) == 1 else f"{best[0]} groups of {best[1]}{backwards}"
    return (*best, f"numbered views taken as {shape}: neighbours are most alike so; --set scene.grid=ROWSxCOLS tells another")


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    views = _views(listing)
    if not views:
        raise UserError(f"{listing.path}: no pictures whose names end in a number", "for example view_000.png")
    low, high = min(views), max(views)
    if high - low + 1 > 4 * len(views):
        raise UserError(f"{listing.path}: {len(views)} views but numbers from {low} to {high}", "number the views without gaps")
    if holes := [number for number in range(low, high + 1) if number not in views]:
        some = ", ".join(str(number) for number in holes[:6]) + (", ..." if len(holes) > 6 else "")
        span = f"{views[low]} and {views[high]}"
        raise UserError(f"{listing.path}: numbers missing between {span}: {some}", "fetch the missing views")
    names = [views[number] for number in sorted(views)]
    grid = parse_grid(scene.grid)
    if grid and grid[0] * grid[1] != len(names):
        raise UserError(f"{listing.path}: {len(names)} views do not make {grid[0]}x{grid[1]}", "scene.grid has to fit")
    rows, cols, snake, why = found_order(_Likeness(listing, names), len(names), grid)
    files = {_place(number, cols, snake): listing.file(name) for number, name in enumerate(names)}
    require_whole(listing, files, rows, cols, names[0])
    return files_source(NAME, listing, files, rows, cols, notes=(why,))
