"""MATLAB files: LFToolbox's NAME__Decoded.mat and BasicLFSR's, variable LF with axes (rows, cols, y, x, planes).

v7.3 files are HDF5 and hold the axes in reverse order; older ones need scipy (`pip install 'lfpipe[scipy]'`).
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import Listing, open_file
from lfpipe.scene.layouts._grid import require_grid, require_view, true_max
from lfpipe.scene.layouts._hdf5 import Hdf5, is_hdf5, unsigned
from lfpipe.scene.layouts._plenoptic import bright_part
from lfpipe.scene.source import SceneSource, Turn

NAME = "mat"
_KEYS = ("LF", "lf", "LightField", "lightfield")
_PLANES = (1, 3, 4, 5)  # grey, colour, and colour with weights behind it


def _file(listing: Listing) -> Path | None:
    names = [name for name in listing.names if name.lower().endswith(".mat")]
    return listing.file(names[0]) if len(names) == 1 else None


def detect(listing: Listing) -> int | None:
    return 90 if _file(listing) is not None else None


def axis_order(shape: tuple[int, ...]) -> tuple[int, ...] | None:
    """Which axes of the array are (rows, cols, y, x[, planes]), by size: planes are few and views larger than the grid.

    Both v7.3 order (planes first) and MATLAB's own (planes last) occur. None if the shape cannot be a light field.
    """
    natural: tuple[int, ...] = tuple(range(len(shape)))
    if len(shape) not in (4, 5) or 0 in shape:
        return None
    sizes = shape if len(shape) == 5 else (*shape, 1)
    if sizes[4] in _PLANES and max(sizes[:2]) <= min(sizes[2:4]):
        return natural
    sizes = shape if len(shape) == 5 else (1, *shape)
    return natural[::-1] if sizes[0] in _PLANES and max(sizes[3:]) <= min(sizes[1:3]) else None


@attrs.frozen(eq=False)
class _Variable:
    """The light field of a file. get: its values at an index. others: names of all variables."""

    key: str
    shape: tuple[int, ...]
    type: np.dtype[Any]
    get: Callable[[Any], NDArray[Any]]
    others: list[str]


def _open(path: Path) -> _Variable:
    """Raises UserError."""
    if is_hdf5(path):
        data = Hdf5(path)
        for key in _KEYS:
            if (shape := data.shape(key)) is not None:
                return _Variable(key, shape, data.type(key), partial(data.piece, key), data.keys())
        there = ", ".join(data.keys()[:8]) or "none"
        raise UserError(f"{path}: no variable LF (found: {there})", "save the light field as LF")
    try:
        import scipy.io
    except ImportError:
        remedy = "pip install 'lfpipe[scipy]', or save it with -v7.3"
        raise UserError(f"{path}: a .mat file older than v7.3 needs scipy", remedy) from None
    with open_file(path) as file:
        try:
            shape = next((shape for name, shape, _ in scipy.io.whosmat(file) if name in _KEYS), None)
            if shape is None:
                raise UserError(f"{path}: no variable LF", "save the light field as LF")
            if axis_order(shape) is None:
                raise _wrong_axes(path, "LF", shape)
            file.seek(0)
            held = scipy.io.loadmat(file, variable_names=list(_KEYS))
        except UserError:
            raise
        except Exception as error:  # scipy's parser may raise anything
            raise UserError(f"{path}: not a readable .mat file: {error!r}"[:300], "save it again, with -v7.3") from None
    for key in _KEYS:
        if isinstance(values := held.get(key), np.ndarray):
            if values.dtype.kind not in "uif":
                raise UserError(f"{path}: {key} contains {values.dtype}, not pictures", "save it as uint8, uint16 or float")
            return _Variable(key, values.shape, values.dtype, partial(np.ndarray.__getitem__, values), [key])
    raise UserError(f"{path}: no variable LF", "save the light field as LF")


def _wrong_axes(path: Path, key: str, shape: tuple[int, ...]) -> UserError:
    wrong = f"{path}: {key} has {len(shape)} axes of sizes {shape}"
    return UserError(f"{wrong}; expected (rows, columns, y, x, planes)", "save it with these axes")


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = _file(listing)
    if path is None:
        raise UserError(f"{listing.path}: not exactly one .mat file", "give the file itself")
    found = _open(path)
    key, shape, kind = found.key, found.shape, found.type
    order = axis_order(shape)
    if order is None:
        raise _wrong_axes(path, key, shape)
    back = order[0] != 0
    all_rows, all_cols, height, width = (shape[axis] for axis in order[:4])
    require_grid(all_rows, all_cols, f"{path}: {key}")
    require_view(height, width, kind.itemsize, f"{path}: {key}")
    most = [1.0]

    def raw(row: int, col: int) -> NDArray[Any]:
        return found.get((..., col, row)).T if back else found.get((row, col))

    def view(row: int, col: int) -> NDArray[Any]:
        pixels = raw(row, col)
        if pixels.ndim == 3:  # a fourth plane is LFToolbox's weight
            pixels = pixels[..., 0] if pixels.shape[2] < 3 else np.ascontiguousarray(pixels[..., :3])
        return unsigned(pixels, path, lambda: most[0])

    middle = raw(all_rows // 2, all_cols // 2)
    if kind.kind == "f" and middle.size and float(np.nanmax(middle, initial=0)) > 1.5:
        most[0] = 255.0
    lit = bright_part(view, all_rows, all_cols)
    top, left, rows, cols, dark = lit.top, lit.left, lit.rows, lit.cols, lit.missing
    full = 255 if kind == np.uint8 else 65535
    top_value = true_max([int(view(top + r, left + c).max()) for r, c in ((rows // 2, cols // 2), (0, cols // 2))], full)
    toolbox = {"LFMetadata", "DecodeOptions", "RectOptions", "WhiteImageMetadata"} & set(found.others)
    notes = (f"the central {rows}x{cols} of {all_rows}x{all_cols} views are used; the others are dark",) if top or left else ()
    return SceneSource(
        layout=NAME, path=listing.path, files=(path,), rows=rows, cols=cols,
        read=lambda frame, row, col: view(row + top, col + left),
        height_px=height, width_px=width, max_value=full if kind.kind == "f" else top_value, missing=frozenset(dark),
        linear=bool(toolbox), notes=notes, turn=Turn() if toolbox else None, turn_firm=False,
        turn_by="LFToolbox counts rows from the top and columns from the left" if toolbox else "",
    )  # fmt: skip
