"""The files of a pack: written view by view without a map (bounded memory), opened as read-only memory maps."""

from __future__ import annotations

import io
import math
import mmap
import os
from pathlib import Path
from typing import Any, BinaryIO

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError, shown
from lfpipe.files.safe_files import reason
from lfpipe.files.untrusted import Fields
from lfpipe.host.descriptors import CAREFUL, read_at, write_at
from lfpipe.scene.half_turn import shown_as
from lfpipe.scene.lightfield import Geometry, LightField
from lfpipe.scene.manifest import DamagedPackError, damaged, open_content, read_manifest
from lfpipe.scene.pack_lock import PackLock


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
        """Creates a file of zeros of that shape."""
        header, kind = _npy_header(shape, np.dtype(dtype)), np.dtype(dtype)
        with path.open("wb") as stream:
            stream.write(header)
            stream.truncate(len(header) + math.prod(shape) * kind.itemsize)
        return cls(os.open(path, os.O_RDWR | CAREFUL), shape, kind, index_axes, len(header))

    def _offset(self, index: tuple[int, ...]) -> int:
        flat = int(np.ravel_multi_index(index, self.shape[: len(index)]))
        return self.start + flat * int(np.prod(self.shape[len(index) :])) * self.dtype.itemsize

    def write(self, index: tuple[int, ...], piece: NDArray[Any]) -> None:
        """Writes a piece, contiguous in the file, at index: of shape shape[len(index):], or any number of its first rows."""
        data = np.ascontiguousarray(piece, self.dtype).reshape(-1).view(np.uint8).data
        offset = self._offset(index)
        while data:
            done = write_at(self.descriptor, data, offset)
            data, offset = data[done:], offset + done

    def read(self, index: tuple[int, ...]) -> NDArray[Any]:
        """The piece at index, a copy."""
        shape = self.shape[self.index_axes :]
        data = read_at(self.descriptor, int(np.prod(shape)) * self.dtype.itemsize, self._offset(index))
        return np.frombuffer(data, self.dtype).reshape(shape)

    def close(self) -> None:
        """Closes the file."""
        os.close(self.descriptor)

    def __enter__(self) -> PlaneFile:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _mapped(file: BinaryIO, path: Path, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """A read-only map of an .npy file. Raises DamagedPackError if shape or type differ."""
    header, count = _npy_header(shape, np.dtype(dtype)), math.prod(shape)
    with file:
        size = os.fstat(file.fileno()).st_size
        if read_at(file.fileno(), len(header), 0) != header or size != len(header) + count * np.dtype(dtype).itemsize:
            raise damaged(path, f"no array of {np.dtype(dtype)} {shape}")
        whole = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
    return np.frombuffer(whole, dtype, count, len(header)).reshape(shape)


def _npy_header(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_2_0(stream, {"descr": dtype.str, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def open_pack(folder: Path, half_turn: str = "auto") -> LightField:
    """The light field of a pack, in the order that scene.half_turn asks for. `lfpipe scene clean` does not remove the pack while
    this object lives.

    Raises DamagedPackError if it is missing, damaged, changed or of another version.
    """
    try:
        hold = PackLock(folder)
    except OSError as error:
        raise damaged(folder, f"no pack: {reason(error)}") from None
    manifest = read_manifest(folder)
    try:
        return shown_as(_light_field(folder, manifest, hold), half_turn)
    except DamagedPackError:
        raise
    except UserError as error:
        raise damaged(folder, error.message) from None
    except (ValueError, TypeError, LookupError, OverflowError, OSError) as error:
        raise damaged(folder, f"not a whole pack: {error}") from None


def _light_field(folder: Path, manifest: dict[str, Any], hold: PackLock) -> LightField:
    """From a sealed manifest; checks its values nevertheless."""
    fields = Fields(manifest, str(folder), "")
    rows, cols, frames = (fields.integer(name, 1, 1 << 20) for name in ("rows", "cols", "frames"))
    height, width = (fields.integer(name, 1, 1 << 20) for name in ("height", "width"))
    channels, about, geometry = fields.integer("channels", 1, 3), fields.table("disparity"), fields.table("geometry")
    views = _mapped(
        open_content(folder, manifest, "views.npy"), folder / "views.npy", (frames, rows, cols, channels, height, width), np.uint8
    )
    disparity = None
    if (source := about.text("source")) != "none":
        shape = (frames, rows, cols, (height + 1) // 2, (width + 1) // 2)
        disparity = _mapped(open_content(folder, manifest, "disparity.npy"), folder / "disparity.npy", shape, np.int8)
    method = fields.text("method")
    if channels == 2 or source not in ("truth", "estimated", "none") or method not in ("nearest", "blend", "warp", "warp2"):
        raise damaged(folder, f"{channels} planes, disparity {shown(source)}, method {shown(method)}: no light field of lfpipe's")
    offsets = np.zeros((rows, cols, 2), np.float32)
    if manifest["offsets"] is not None:
        offsets = np.asarray(fields.items("offsets", rows), np.float32).reshape(rows, cols, 2)
        if not (np.abs(offsets) <= 1).all():
            raise damaged(folder, "offsets of more than a grid step")
    return LightField(
        views=views,
        disparity=disparity,
        disparity_scale_px=about.number("scale_px", 1e-6, 1e3),
        disparity_min_px=about.number("min_px", -1e5, 1e5),
        disparity_max_px=about.number("max_px", -1e5, 1e5),
        disparity_source=source,
        offsets=offsets,
        present=np.asarray(fields.items("present", rows), bool).reshape(rows, cols),
        geometry=Geometry(**{name: geometry.number(name, 0, 1e15) for name, v in geometry.values.items() if v is not None}),
        frame_rate_hz=fields.number("frame_rate_hz", 0, 1e4),
        name=fields.text("name"),
        method=method,
        manifest=manifest,
        hold=hold,
    )


def check_pack(folder: Path) -> int:
    """Verifies every byte of a pack; returns its size in bytes. Raises DamagedPackError."""
    field = open_pack(folder)
    total = 0
    for name in field.manifest["contents"]:
        with open_content(folder, field.manifest, name, whole=True) as file:
            total += os.fstat(file.fileno()).st_size
    return total
