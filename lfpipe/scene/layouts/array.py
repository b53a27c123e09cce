"""Arrays on disk, .npy or .npz (numpy.save, numpy.savez), with axes (rows, cols, height, width, planes) or frames before them.

Planes are 1 (grey) or 3 (red first); row 0 is the top row of cameras, column 0 the left one. uint8, uint16, or float 0 .. 1.
An .npz holds `views`, and perhaps `disparity` (rows, cols, height, width), px per view, nearer is larger; and `positions`
(rows, cols, 2), where each camera stood, (down, right) in any unit.
"""

import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import require_grid, require_view
from lfpipe.scene.layouts._hdf5 import unsigned
from lfpipe.scene.source import SceneSource, Turn

NAME = "array"
SUFFIXES = (".npy", ".npz")
VIEWS, DISPARITY, POSITIONS = "views", "disparity", "positions"
AXES = "(rows, cols, height, width, 1 or 3), or (frames, rows, cols, height, width, 1 or 3)"
MEMBER_BYTES = 2 << 30  # of an .npz, which must be read as a whole; .npy is mapped


def detect(listing: Listing) -> int | None:
    return 90 if listing.is_file and listing.names[0].lower().endswith(SUFFIXES) else None


def require_views(views: NDArray[Any], what: str) -> NDArray[Any]:
    """views with an axis of frames. Raises UserError for other axes and types. what: its name, for messages."""
    if views.ndim not in (5, 6) or views.shape[-1] not in (1, 3):
        raise UserError(f"{what}: axes of sizes {views.shape}", f"expected {AXES}")
    if views.dtype not in (np.uint8, np.uint16) and views.dtype.kind != "f":
        raise UserError(f"{what}: values of type {views.dtype}", "expected uint8, uint16 or float 0 .. 1")
    framed = views if views.ndim == 6 else views[None]
    frames, rows, cols, height, width, _ = framed.shape
    if frames < 1:
        raise UserError(f"{what}: no frame", f"expected {AXES}")
    require_grid(rows, cols, what)
    require_view(height, width, views.dtype.itemsize, what)
    return framed


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a file by name. Raises UserError."""
    remedy = "save it with numpy.save or numpy.savez, without objects"
    try:
        if path.suffix.lower() == ".npy":
            return {VIEWS: np.load(path, mmap_mode="r", allow_pickle=False)}
        with zipfile.ZipFile(path) as archive:
            largest = max((entry.file_size for entry in archive.infolist()), default=0)
        if largest > MEMBER_BYTES:
            raise UserError(f"{path}: an array of {largest / 1e6:.0f} MB", "save the views with numpy.save, as .npy")
        with np.load(path, allow_pickle=False) as held:
            names = [name for name in (VIEWS, DISPARITY, POSITIONS) if name in held.files]
            if VIEWS not in names and len(held.files) == 1:
                return {VIEWS: held[held.files[0]]}
            return {name: held[name] for name in names}
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile, MemoryError) as error:
        raise UserError(f"{path}: not a readable array: {error or type(error).__name__}"[:300], remedy) from None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = listing.file(listing.names[0])
    held = _arrays(path)
    if VIEWS not in held:
        raise UserError(f"{path}: no array {VIEWS!r}", f"numpy.savez(FILE, {VIEWS}=...) with axes {AXES}")
    views = require_views(held[VIEWS], str(path))
    frames, rows, cols, height, width, planes = views.shape
    truth = {}
    if (disparity := held.get(DISPARITY)) is not None:
        if disparity.shape != (rows, cols, height, width) or disparity.dtype.kind not in "fiu":
            raise UserError(f"{path}: {DISPARITY} has sizes {disparity.shape}", f"expected {(rows, cols, height, width)}")

        def true_map(row: int, col: int) -> NDArray[np.float32]:
            return np.asarray(disparity[row, col], np.float32)

        truth = {(row, col): partial(true_map, row, col) for row in range(rows) for col in range(cols)}
    if (positions := held.get(POSITIONS)) is not None and (
        positions.shape != (rows, cols, 2) or positions.dtype.kind not in "fiu" or not np.isfinite(positions).all()
    ):
        raise UserError(f"{path}: {POSITIONS} has sizes {positions.shape}", f"expected {(rows, cols, 2)}, finite numbers")

    def read(frame: int, row: int, col: int) -> NDArray[Any]:
        pixels = unsigned(np.asarray(views[frame, row, col]), path)
        return np.ascontiguousarray(pixels if planes == 3 else pixels[..., 0])

    return SceneSource(
        layout=NAME, path=listing.path, files=(path,), rows=rows, cols=cols, read=read, height_px=height, width_px=width,
        max_value=255 if views.dtype == np.uint8 else 65535, frames=frames, frame_rate_hz=30.0 if frames > 1 else 0.0,
        turn=Turn(), turn_by="rows of the array are counted from the top, columns from the left", turn_firm=False,
        coordinates=None if positions is None else np.asarray(positions, np.float64), truth=truth,
    )  # fmt: skip
