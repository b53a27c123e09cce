"""The files of a pack: written view by view without a map (bounded memory), opened as read-only memory maps."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.cache import VERSION
from lfpipe.scene.lightfield import Geometry, LightField

_REMEDY = "`lfpipe scene pack` makes it again"


class DamagedPackError(UserError):
    """A folder that is not a whole pack of this version."""


@attrs.frozen
class PlaneFile:
    """An .npy file read and written in pieces, by the first `index_axes` axes. Safe from several threads.

    Written with pwrite: pages of a map would count as memory of the process until the kernel writes them back.
    """

    descriptor: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    index_axes: int
    start: int

    @classmethod
    def create(cls, path: Path, shape: tuple[int, ...], dtype: Any, index_axes: int) -> PlaneFile:
        """A new file of zeros of that shape."""
        with path.open("wb") as stream:
            kind = np.dtype(dtype)
            np.lib.format.write_array_header_2_0(stream, {"descr": kind.str, "fortran_order": False, "shape": shape})
            start = stream.tell()
            stream.truncate(start + int(np.prod(shape, dtype=np.int64)) * kind.itemsize)
        return cls(os.open(path, os.O_RDWR), shape, kind, index_axes, start)

    def _offset(self, index: tuple[int, ...]) -> int:
        flat = int(np.ravel_multi_index(index, self.shape[: self.index_axes]))
        return self.start + flat * int(np.prod(self.shape[self.index_axes :])) * self.dtype.itemsize

    def write(self, index: tuple[int, ...], piece: NDArray[Any]) -> None:
        """Put a piece of shape shape[index_axes:] at index."""
        data = np.ascontiguousarray(piece, self.dtype).reshape(-1).view(np.uint8).data
        offset = self._offset(index)
        while data:
            done = os.pwrite(self.descriptor, data, offset)
            data, offset = data[done:], offset + done

    def read(self, index: tuple[int, ...]) -> NDArray[Any]:
        """The piece at index, a copy."""
        shape = self.shape[self.index_axes :]
        data = os.pread(self.descriptor, int(np.prod(shape)) * self.dtype.itemsize, self._offset(index))
        return np.frombuffer(data, self.dtype).reshape(shape)

    def close(self) -> None:
        """Nothing can be read or written after this."""
        os.close(self.descriptor)

    def __enter__(self) -> PlaneFile:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _mapped(path: Path, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """A read-only map of an .npy file. Raises DamagedPackError where it is not of that shape and type."""
    try:
        found = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise DamagedPackError(f"{path}: damaged: {error}", _REMEDY) from None
    if found.shape != shape or found.dtype != dtype:
        raise DamagedPackError(f"{path}: {found.dtype} {found.shape}, not {np.dtype(dtype)} {shape}", _REMEDY)
    return np.asarray(found)  # a plain view: slicing np.memmap costs more


def open_pack(folder: Path) -> LightField:
    """The light field of a pack. Raises DamagedPackError where it is missing, damaged or of another version."""
    try:
        manifest = json.loads((folder / "manifest.json").read_bytes())
        if manifest["version"] != VERSION:
            raise DamagedPackError(f"{folder}: pack of version {manifest['version']}, this lfpipe reads {VERSION}", _REMEDY)
        rows, cols, frames = (int(manifest[name]) for name in ("rows", "cols", "frames"))
        size = int(manifest["height"]), int(manifest["width"])
        views = _mapped(folder / "views.npy", (frames, rows, cols, int(manifest["channels"]), *size), np.uint8)
        disparity, about = None, manifest["disparity"]
        if about["source"] != "none":
            halves = (size[0] + 1) // 2, (size[1] + 1) // 2
            disparity = _mapped(folder / "disparity.npy", (frames, rows, cols, *halves), np.int8)
        offsets = np.zeros((rows, cols, 2), np.float32)
        if manifest["offsets"] is not None:
            offsets = np.asarray(manifest["offsets"], np.float32).reshape(rows, cols, 2)
        return LightField(
            views=views,
            disparity=disparity,
            disparity_scale_px=float(about["scale_px"]),
            disparity_min_px=float(about["min_px"]),
            disparity_max_px=float(about["max_px"]),
            disparity_source=str(about["source"]),
            offsets=offsets,
            present=np.asarray(manifest["present"], bool).reshape(rows, cols),
            geometry=Geometry(**manifest["geometry"]),
            frame_rate_hz=float(manifest["frame_rate_hz"]),
            name=str(manifest["name"]),
            method=str(manifest["method"]),
            manifest=manifest,
        )
    except DamagedPackError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DamagedPackError(f"{folder}: not a whole pack: {error!r}", _REMEDY) from None
