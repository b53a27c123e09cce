"""Picture files whose names end in row and column: `*_RR_CC.*`, counted from 0 or 1."""

from __future__ import annotations

import re
from collections import Counter

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import PICTURES, Listing
from lfpipe.scene.layouts._grid import files_source, named_grid, parse_grid, require_whole
from lfpipe.scene.source import SceneSource

NAME = "rows-cols"
_VIEW = re.compile(r"(.*?)[_.-]?[rR]?(\d{1,4})[_x-][cC]?(\d{1,4})(\.\w+)")


def _views(listing: Listing) -> dict[tuple[int, int], str]:
    """The largest family of names that differ in two numbers only, by those numbers."""
    families: Counter[tuple[str, str]] = Counter()
    found = {name: match for name in listing.pictures() if (match := _VIEW.fullmatch(name)) and match[4].lower() in PICTURES}
    families.update((match[1], match[4].lower()) for match in found.values())
    if not families:
        return {}
    family = max(families, key=lambda key: (families[key], key))
    pairs: dict[tuple[int, int], str] = {}
    for name, match in found.items():
        if (match[1], match[4].lower()) == family:
            place = int(match[2]), int(match[3])
            if place in pairs:
                raise UserError(f"{listing.path}: {pairs[place]} and {name} both stand for {place[0]}, {place[1]}", "keep one")
            pairs[place] = name
    return pairs


def detect(listing: Listing) -> int | None:
    if listing.is_file:
        return None
    pairs = _views(listing)
    if len(pairs) < 2:
        return None
    rows, cols = len({r for r, _ in pairs}), len({c for _, c in pairs})
    # Prefix_date_NNN also ends in two numbers, but then one of them never changes or the grid is mostly holes.
    return 50 if 2 * len(pairs) > rows * cols and (rows > 1 or cols > 1) else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    pairs = _views(listing)
    if not pairs:
        raise UserError(f"{listing.path}: no picture whose name ends in _ROW_COLUMN", "for example view_00_00.png")
    files, rows, cols = named_grid(pairs, listing)
    grid = parse_grid(scene.grid)
    if grid is not None and grid != (rows, cols):
        raise UserError(f"{listing.path}: the names say {rows}x{cols}, scene.grid says {grid[0]}x{grid[1]}", "leave the key away")
    require_whole(listing, files, rows, cols, next(iter(pairs.values())))
    return files_source(NAME, listing, files, rows, cols)
