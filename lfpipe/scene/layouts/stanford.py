"""The Stanford light field archive: out_RR_CC_Y_X_.png, where Y and X are the camera's position.

Coordinates decide, never the index: X grows to the right, Y downwards, and scenes were shot in either direction.
http://lightfield.stanford.edu; variants of prefix, suffix and further fields occur in copies.
"""

import re

import numpy as np

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.untrusted import in_range
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import files_source, named_grid, require_whole
from lfpipe.scene.source import SceneSource, Turn

NAME = "stanford"
_FARTHEST = 1e9  # in whatever unit: mm or px
_NUMBER = r"(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)"
_VIEW = re.compile(rf".*?out_(\d{{1,4}})_(\d{{1,4}})_{_NUMBER}_{_NUMBER}(?:_{_NUMBER})*_?\.(?:png|jpe?g|ppm)", re.IGNORECASE)


def detect(listing: Listing) -> int | None:
    return 90 if not listing.is_file and sum(_VIEW.fullmatch(name) is not None for name in listing.names) > 1 else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    found = {name: match for name in listing.names if (match := _VIEW.fullmatch(name))}
    if not found:
        raise UserError(f"{listing.path}: no out_ROW_COLUMN_Y_X_.png", "give the folder of the views")
    pairs = {(int(match[1]), int(match[2])): name for name, match in found.items()}
    if len(pairs) < len(found):
        raise UserError(f"{listing.path}: {len(found) - len(pairs)} files name a row and column twice", "keep one file per view")
    files, rows, cols = named_grid(pairs, listing)
    require_whole(listing, files, rows, cols, next(iter(found)))
    stood = np.full((rows, cols, 2), np.nan)
    for place, path in files.items():
        match = found[path.name]
        what, remedy = f"{path}: a camera coordinate", "rename the file"
        stood[place] = [in_range(float(match[axis]), -_FARTHEST, _FARTHEST, what, remedy) for axis in (3, 4)]
    turn, sure = coordinate_turn(stood)
    return files_source(
        NAME, listing, files, rows, cols, coordinates=stood if sure else None,
        turn=turn if sure else None, turn_by="camera coordinates in the names" if sure else "",
    )  # fmt: skip


def coordinate_turn(stood: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[Turn, bool]:
    """From coordinates (rows, cols, 2) as (down, right) in file order: the turn to canonical order, and whether they determine
    it.

    Along each index axis the mean step of the coordinate that moves most decides.
    """
    down_by_row, right_by_row = stood.mean(axis=1).T
    down_by_col, right_by_col = stood.mean(axis=0).T

    def run(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
        return float(values[-1] - values[0])

    straight = abs(run(down_by_row)) + abs(run(right_by_col))
    crossed = abs(run(right_by_row)) + abs(run(down_by_col))
    if straight == crossed:
        return Turn(), False
    if straight > crossed:
        return Turn(rows=run(down_by_row) < 0, cols=run(right_by_col) < 0), True
    return Turn(rows=run(down_by_col) < 0, cols=run(right_by_row) < 0, transpose=True), True
