"""The first HCI data set: one lf.h5 with LF (rows, cols, y, x, 3), GT_DEPTH and attributes; columns run right to left.

Wanner, Meister, Goldluecke, "Datasets and Benchmarks for Densely Sampled 4D Light Fields", VMV 2013.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import require_grid, require_view
from lfpipe.scene.layouts._hdf5 import Hdf5, unsigned
from lfpipe.scene.layouts.hci_text import disparity_of_depth, require_plausible
from lfpipe.scene.source import SceneSource, Turn

NAME = "hci-old"
_ENDS = (".h5", ".hdf5")


def _file(listing: Listing) -> Path | None:
    names = [name for name in listing.names if name.lower().endswith(_ENDS)]
    if len(names) > 1 and "lf.h5" in names:
        names = ["lf.h5"]
    return listing.file(names[0]) if len(names) == 1 else None


def detect(listing: Listing) -> int | None:
    return 90 if _file(listing) is not None else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = _file(listing)
    if path is None:
        raise UserError(f"{listing.path}: not exactly one .h5 file", "give the file itself")
    data = Hdf5(path)
    shape = data.shape("LF")
    if shape is None:
        there = ", ".join(data.keys()[:8]) or "none"
        raise UserError(f"{path}: no data set LF (found: {there})", "save the light field as LF")
    grey = shape[4:] == (1,) or (len(shape) == 4 and max(shape[:2]) <= min(shape[2:]))  # else an axis is missing
    if not grey and (len(shape) != 5 or shape[4] != 3 or 0 in shape):
        raise UserError(f"{path}: LF has shape {shape}, expected (rows, columns, y, x, 3)", "save it with these axes")
    rows, cols, height, width = shape[:4]
    require_grid(rows, cols, f"{path}: LF")
    require_view(height, width, data.type("LF").itemsize, f"{path}: LF")
    known = data.attributes()
    require_plausible(known, path)
    truth = {}

    def read_truth(row: int, col: int) -> NDArray[np.float32]:
        depth = data.piece("GT_DEPTH", (row, col)).astype(np.float32)
        return disparity_of_depth(depth, known["dH"], known["focalLength"], known.get("shift", 0.0))

    if data.shape("GT_DEPTH") == shape[:4] and known.get("dH") and known.get("focalLength"):
        truth = {(row, col): partial(read_truth, row, col) for row in range(rows) for col in range(cols)}
    kind = data.type("LF")

    def read(frame: int, row: int, col: int) -> NDArray[Any]:
        view = unsigned(data.piece("LF", (row, col)), path)
        return view[..., 0] if shape[4:] == (1,) else view

    return SceneSource(
        layout=NAME, path=listing.path, files=(path,), rows=rows, cols=cols,
        read=read, height_px=height, width_px=width, max_value=255 if kind == np.uint8 else 65535, truth=truth,
        turn=Turn(cols=True), turn_by="the columns of lf.h5 run from right to left",
    )  # fmt: skip
