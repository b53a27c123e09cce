"""Plenoptic cameras. ESLF: one PNG, with `eslf` in its name, of lenslets of N x N px (14 x 14 for a
Lytro Illum; else scene.grid), as in LFToolbox's LFReadESLF; pixel (row, col) of every lenslet forms
one view. The outer views are dark or empty.
"""

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.files.pictures import read_picture
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import parse_grid
from lfpipe.scene.layouts._names import ESLF, words
from lfpipe.scene.layouts._tiles import require_picture, single_picture
from lfpipe.scene.source import GridTransform, SceneSource, ViewIndex

NAME = "eslf"
# brightness over that of the middle view; darker sides and views are left out
_DARK_SIDE, _DARK_VIEW = 0.55, 0.4


def lit(source: SceneSource) -> SceneSource:
    """The source without its dark sides, evenly from both ends; dark views in the corners count as
    missing.
    """

    def light(row: int, col: int) -> float:
        return (
            0.0
            if (row, col) in source.missing
            else float(source.read(0, row, col)[::4, ::4].mean())
        )

    all_rows, all_cols = source.rows, source.cols
    middle = light(all_rows // 2, all_cols // 2)
    top = left = 0
    while (
        all_rows - 2 * top > 2
        and min(light(r, all_cols // 2) for r in (top, all_rows - 1 - top)) < _DARK_SIDE * middle
    ):
        top += 1
    while (
        all_cols - 2 * left > 2
        and min(light(all_rows // 2, c) for c in (left, all_cols - 1 - left)) < _DARK_SIDE * middle
    ):
        left += 1
    rows, cols = all_rows - 2 * top, all_cols - 2 * left
    missing: set[ViewIndex] = set()
    for row, col in np.ndindex(rows, cols):
        # brightness falls off only towards the corners: no need to check the rest of the grid
        corner = min(row, rows - 1 - row) + min(col, cols - 1 - col) < max(1, min(rows, cols) // 4)
        if (row + top, col + left) in source.missing or (
            corner and light(row + top, col + left) < _DARK_VIEW * middle
        ):
            missing.add((row, col))
    note = f"the central {rows}x{cols} of {all_rows}x{all_cols} views are used; the others are dark"
    small = source.small
    return attrs.evolve(
        source,
        rows=rows,
        cols=cols,
        missing=frozenset(missing),
        notes=(*source.notes, note) if top or left else source.notes,
        read=lambda frame, row, col: source.read(frame, row + top, col + left),
        small=None
        if small is None
        else lambda row, col, most_px: small(row + top, col + left, most_px),
    )


def detect(listing: Listing) -> int | None:
    path = single_picture(listing)
    return 90 if path is not None and ESLF.search(words(path.name)) else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = require_picture(listing)
    picture, full = read_picture(path)
    rows, cols = parse_grid(scene.grid) or (14, 14)  # a Lytro Illum's
    below, beside = -picture.shape[0] % rows, -picture.shape[1] % cols
    if below or beside:  # LFToolbox pads at the end
        picture = cv2.copyMakeBorder(picture, 0, below, 0, beside, cv2.BORDER_CONSTANT)
    return lit(
        SceneSource(
            layout=NAME,
            path=listing.path,
            files=(path,),
            rows=rows,
            cols=cols,
            read=lambda frame, row, col: np.ascontiguousarray(picture[row::rows, col::cols]),
            height_px=picture.shape[0] // rows,
            width_px=picture.shape[1] // cols,
            max_value=full,
            turn=GridTransform(),
            turn_firm=False,
            turn_by="an ESLF picture counts rows from the top and columns from the left",
        )
    )
