"""MATLAB files: LFToolbox's NAME__Decoded.mat and BasicLFSR's, variable LF with axes (rows, cols, y, x, planes).

v7.3 files are HDF5 and hold the axes in reverse order; older ones need scipy (`pip install 'lfpipe[scipy]'`).
"""

import os
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Literal

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
_ORDERS: dict[bytes, Literal["little", "big"]] = {b"IM": "little", b"MI": "big"}
_MAX_VARIABLES = 1000
_PIECE_BYTES, _MAX_PIECE_BYTES = 1 << 17, 40_000_000  # of compressed data, and of its unpacked size
_SMALL_BYTES, _MAX_RATIO = 40_000_000, 100  # unpacked over stored size, above that; pictures compress 2 to 10 times


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


def _open(path: Path) -> tuple[str, tuple[int, ...], np.dtype[Any], Callable[[Any], NDArray[Any]], list[str]]:
    """(key, shape, type, reader of an index, all keys) of the light field. Raises UserError."""
    if is_hdf5(path):
        data = Hdf5(path)
        for key in _KEYS:
            if (shape := data.shape(key)) is not None:
                return key, shape, data.type(key), partial(data.piece, key), data.keys()
        there = ", ".join(data.keys()[:8]) or "none"
        raise UserError(f"{path}: no variable LF (found: {there})", "save the light field as LF")
    try:
        import scipy.io
    except ImportError:
        remedy = "pip install 'lfpipe[scipy]', or save it with -v7.3"
        raise UserError(f"{path}: a .mat file older than v7.3 needs scipy", remedy) from None
    with open_file(path) as file:
        _require_whole(path, file)
        try:
            file.seek(0)
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
            return key, values.shape, values.dtype, partial(np.ndarray.__getitem__, values), [key]
    raise UserError(f"{path}: no variable LF", "save the light field as LF")


def _require_whole(path: Path, file: BinaryIO) -> None:
    """Raises UserError if variables of a .mat file (version 5) are incomplete, or unpack to far more than pictures would.

    Each is a tag of type and size, 4 bytes each, and zlib data if the type is 15. This unpacks it piece by piece; scipy would
    unpack it all at once.
    """
    size, at, unpacked = os.fstat(file.fileno()).st_size, 128, 0
    order = _ORDERS.get(file.read(at)[126:])
    if order is None:
        raise UserError(f"{path}: not a readable .mat file of version 5 or 7.3", "save it again, with -v7.3")
    variables = 0
    while at + 8 <= size:
        variables += 1
        if variables > _MAX_VARIABLES:  # zeros after the last one look like empty variables
            raise UserError(f"{path}: more than {_MAX_VARIABLES} variables", "save only the light field, as LF")
        file.seek(at)
        tag = file.read(8)
        kind, left = (int.from_bytes(tag[k : k + 4], order) for k in (0, 4))
        at += 8 + left
        if at > size:
            raise UserError(f"{path}: ends within a variable: {size} bytes, {at} needed", "fetch or save it again")
        engine = zlib.decompressobj()
        while left and kind == 15:
            data = file.read(min(left, _PIECE_BYTES))
            left -= len(data)
            before = unpacked
            try:
                while data:
                    unpacked += len(engine.decompress(data, _PIECE_BYTES))
                    data = engine.unconsumed_tail
            except zlib.error as error:
                raise UserError(f"{path}: not a readable .mat file: {error}", "fetch or save it again") from None
            if unpacked - before > _MAX_PIECE_BYTES or unpacked > _SMALL_BYTES + _MAX_RATIO * size:
                raise UserError(f"{path}: {size} bytes that decompress to more than {unpacked}", "save it again, with -v7.3")
        if kind == 15 and not engine.eof:
            raise UserError(f"{path}: a variable ends before its data does", "fetch or save it again")


def _wrong_axes(path: Path, key: str, shape: tuple[int, ...]) -> UserError:
    wrong = f"{path}: {key} has {len(shape)} axes of sizes {shape}"
    return UserError(f"{wrong}; expected (rows, columns, y, x, planes)", "save it with these axes")


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = _file(listing)
    if path is None:
        raise UserError(f"{listing.path}: not exactly one .mat file", "give the file itself")
    key, shape, kind, get, keys = _open(path)
    order = axis_order(shape)
    if order is None:
        raise _wrong_axes(path, key, shape)
    back = order[0] != 0
    all_rows, all_cols, height, width = (shape[axis] for axis in order[:4])
    require_grid(all_rows, all_cols, f"{path}: {key}")
    require_view(height, width, kind.itemsize, f"{path}: {key}")
    most = [1.0]

    def raw(row: int, col: int) -> NDArray[Any]:
        return get((..., col, row)).T if back else get((row, col))

    def view(row: int, col: int) -> NDArray[Any]:
        pixels = raw(row, col)
        if pixels.ndim == 3:  # a fourth plane is LFToolbox's weight
            pixels = pixels[..., 0] if pixels.shape[2] < 3 else np.ascontiguousarray(pixels[..., :3])
        return unsigned(pixels, path, lambda: most[0])

    middle = raw(all_rows // 2, all_cols // 2)
    if kind.kind == "f" and middle.size and float(np.nanmax(middle, initial=0)) > 1.5:
        most[0] = 255.0
    top, left, rows, cols, dark = bright_part(view, all_rows, all_cols)
    full = 255 if kind == np.uint8 else 65535
    top_value = true_max([int(view(top + r, left + c).max()) for r, c in ((rows // 2, cols // 2), (0, cols // 2))], full)
    toolbox = {"LFMetadata", "DecodeOptions", "RectOptions", "WhiteImageMetadata"} & set(keys)
    notes = (f"the central {rows}x{cols} of {all_rows}x{all_cols} views are used; the others are dark",) if top or left else ()
    return SceneSource(
        layout=NAME, path=listing.path, files=(path,), rows=rows, cols=cols,
        read=lambda frame, row, col: view(row + top, col + left),
        height_px=height, width_px=width, max_value=full if kind.kind == "f" else top_value, missing=frozenset(dark),
        linear=bool(toolbox), notes=notes, turn=Turn() if toolbox else None, turn_firm=False,
        turn_by="LFToolbox counts rows from the top and columns from the left" if toolbox else "",
    )  # fmt: skip
