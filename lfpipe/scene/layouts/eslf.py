"""ESLF: one PNG of lenslets, N x N px each (14 x 14 of a Lytro Illum); pixel (row, col) of every lenslet is one view.

As in LFToolbox's LFReadESLF; a picture that is not a multiple of N is padded at its end.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import read_picture
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import parse_grid
from lfpipe.scene.layouts._plenoptic import bright_part
from lfpipe.scene.layouts._tiles import single_picture
from lfpipe.scene.source import SceneSource, Turn

NAME = "eslf"
_USUAL = 14
_PITCHES = range(5, 25)
_GLANCE_PX = 1024


def lenslet_pitch(picture: NDArray[Any]) -> int | None:
    """The side of a lenslet in px, or None: neighbouring lenslets are nearly alike, their halves are not."""
    plane = picture if picture.ndim == 2 else picture[..., 1]
    top, left = ((max(0, size - _GLANCE_PX)) // 2 for size in plane.shape)
    part = plane[top : top + _GLANCE_PX, left : left + _GLANCE_PX].astype(np.float32)
    if min(part.shape) < 4 * max(_PITCHES):
        return None

    def unlike(shift: int, axis: int) -> float:
        a, b = (part[shift:], part[:-shift]) if axis == 0 else (part[:, shift:], part[:, :-shift])
        return float(np.mean((a - b) ** 2))

    found: dict[int, float] = {}
    for pitch in _PITCHES:
        halves = [min(unlike(pitch // 2, axis), unlike(pitch + pitch // 2, axis)) for axis in (0, 1)]
        if min(halves) > 1:
            found[pitch] = max(unlike(pitch, axis) / half for axis, half in zip((0, 1), halves, strict=True))
    best = min(found, key=lambda pitch: found[pitch], default=0)
    return best if found.get(best, 1.0) < 0.5 else None


def detect(listing: Listing) -> int | None:
    path = single_picture(listing)
    if path is None:
        return None
    if "eslf" in path.stem.lower():
        return 90
    try:
        return 70 if lenslet_pitch(read_picture(path)[0]) else None
    except UserError:
        return None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = single_picture(listing)
    if path is None:
        raise UserError(f"{listing.path}: not exactly one lenslet picture", "give the file itself")
    picture, full = read_picture(path)
    grid, pitch = parse_grid(scene.grid), lenslet_pitch(picture)
    all_rows, all_cols = grid or ((pitch, pitch) if pitch else (_USUAL, _USUAL))
    below, beside = -picture.shape[0] % all_rows, -picture.shape[1] % all_cols
    if below or beside:
        picture = cv2.copyMakeBorder(picture, 0, below, 0, beside, cv2.BORDER_CONSTANT)
    height, width = picture.shape[0] // all_rows, picture.shape[1] // all_cols

    def view(row: int, col: int) -> NDArray[Any]:
        return np.ascontiguousarray(picture[row::all_rows, col::all_cols])

    lit = bright_part(view, all_rows, all_cols)
    top, left, rows, cols, dark = lit.top, lit.left, lit.rows, lit.cols, lit.missing
    notes = (f"the central {rows}x{cols} of {all_rows}x{all_cols} views are used; the others are dark",) if top or left else ()
    return SceneSource(
        certain="eslf" in path.stem.lower(), layout=NAME, path=listing.path, files=(path,), rows=rows, cols=cols,
        read=lambda frame, row, col: view(row + top, col + left),
        height_px=height, width_px=width, max_value=full, missing=frozenset(dark), notes=notes,
        turn=Turn(), turn_firm=False, turn_by="an ESLF picture counts rows from the top and columns from the left",
    )  # fmt: skip
