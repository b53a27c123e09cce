"""JPEG Pleno / EPFL: RRR_CCC.ppm or .png of a Lytro Illum, 15x15 with dark sides and corners, 8, 10 or 16 bit.

The JPEG Pleno common test conditions use the central 13x13; corner views may be absent.
"""

import re
from typing import Any

from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import read_picture
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import files_source, named_grid, require_whole
from lfpipe.scene.layouts._plenoptic import bright_part
from lfpipe.scene.source import SceneSource, Turn

NAME = "jpeg-pleno"
_VIEW = re.compile(r"(\d{3})_(\d{3})\.(?:ppm|png)", re.IGNORECASE)


def detect(listing: Listing) -> int | None:
    return 80 if not listing.is_file and sum(_VIEW.fullmatch(name) is not None for name in listing.names) > 1 else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    pairs = {(int(found[1]), int(found[2])): name for name in listing.names if (found := _VIEW.fullmatch(name))}
    if not pairs:
        raise UserError(f"{listing.path}: no ROW_COLUMN.ppm with three digits each", "leave out --layout, or give their folder")
    files, rows, cols = named_grid(pairs, listing)

    def read(row: int, col: int) -> NDArray[Any] | None:
        return read_picture(files[row, col])[0] if (row, col) in files else None

    lit = bright_part(read, rows, cols)
    top, left, rows, cols, dark = lit.top, lit.left, lit.rows, lit.cols, lit.missing
    inside = {(r - top, c - left): path for (r, c), path in files.items() if 0 <= r - top < rows and 0 <= c - left < cols}
    reach = max(1, min(rows, cols) // 4)
    for r in range(rows):
        for c in range(cols):
            if min(r, rows - 1 - r) + min(c, cols - 1 - c) >= reach and (r, c) not in inside:
                require_whole(listing, {**dict.fromkeys(dark, listing.path), **inside}, rows, cols, next(iter(pairs.values())))
    kept = {place: path for place, path in inside.items() if place not in dark}
    notes = []
    if top or left:
        notes.append(f"the central {rows}x{cols} views are used; those outside are dark")
    if len(kept) < rows * cols:
        notes.append(f"{rows * cols - len(kept)} corner views are absent or dark")
    return files_source(
        NAME, listing, kept, rows, cols, notes=tuple(notes),
        turn=Turn(), turn_firm=False, turn_by="JPEG Pleno counts rows from the top and columns from the left",
    )  # fmt: skip
