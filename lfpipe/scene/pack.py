"""A pack on disk: planar arrays opened as read-only memory maps, and manifest.json with everything else.

    views.npy       uint8 (frames, rows, cols, channels, height, width)
    disparity.npy   int8 (frames, rows, cols, half height, half width); only of a complete pack
    manifest.json   "views": whether all views are there, not only those in the middle; "complete": the disparity, too;
                    "checksum": of the rest of the manifest

The arrays are written view by view without a map (bounded memory). Views come first: a pack without disparity can be shown.
"""

import contextlib
import hashlib
import io
import json
import math
import mmap
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SceneSummary
from lfpipe.errors import UserError
from lfpipe.files.safe_files import open_regular, read_bytes, reason
from lfpipe.files.untrusted import json_fields
from lfpipe.host import file_lock
from lfpipe.host.files import CAREFUL, read_at, write_at
from lfpipe.scene.half_turn import shown_as
from lfpipe.scene.lightfield import Geometry, LightField

MANIFEST = "manifest.json"
VERSION = 10  # of the pack; another version is another key
_MAX_BYTES = 16 << 20
_REMEDY = "`lfpipe scene pack` makes it again"


class DamagedPackError(UserError):
    """A folder that is no pack of this version, or a damaged one."""


def damaged(where: Path, why: str) -> DamagedPackError:
    """The error that names a pack or a file of it."""
    return DamagedPackError(f"{where}: {why}", _REMEDY)


def _checksum(manifest: dict[str, Any]) -> str:
    body = {key: value for key, value in manifest.items() if key != "checksum"}
    return hashlib.blake2b(json.dumps(body, sort_keys=True, allow_nan=False).encode(), digest_size=16).hexdigest()


def write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    """Writes the manifest with its checksum atomically. Raises OSError."""
    new = folder / f".{MANIFEST}.{os.getpid()}"
    try:
        new.write_text(json.dumps({**manifest, "checksum": _checksum(manifest)}, indent=1, allow_nan=False))
        new.replace(folder / MANIFEST)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a pack. Raises DamagedPackError if it is missing, changed or of another version."""
    try:
        fields = json_fields(read_bytes(folder / MANIFEST, _MAX_BYTES), str(folder / MANIFEST), _REMEDY)
    except OSError as error:
        raise damaged(folder, f"not a pack: {MANIFEST} cannot be read: {reason(error)}") from None
    except UserError as error:
        raise DamagedPackError(error.message, _REMEDY) from None
    manifest = dict(fields.values)
    if manifest.get("version") != VERSION:
        raise damaged(folder, f"a pack of another version; this lfpipe reads version {VERSION}")
    if manifest.get("checksum") != _checksum(manifest):
        raise damaged(folder / MANIFEST, "changed after the pack was made")
    return manifest


class PackLock:
    """Protects a pack from removal while this object lives. A killed process holds no lock."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError if there is no such folder or it is being removed."""
        self._lock = None
        if not folder.is_dir():
            raise FileNotFoundError(2, os.strerror(2), str(folder))
        self._lock = file_lock.take(folder, shared=True)
        if self._lock is None:
            raise BlockingIOError(11, "it is being removed", str(folder))
        if not self._lock.in_place():
            raise FileNotFoundError(2, "it was removed", str(folder))

    def __del__(self) -> None:
        if self._lock is not None:
            self._lock.release()

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        """Pickles as None: a lock is not copied to another process."""
        return type(None), ()


@contextlib.contextmanager
def unused(folder: Path) -> Iterator[bool]:
    """Whether no process holds the pack; if so, none can lock it until the end of the block. Raises OSError."""
    if not folder.is_dir():
        raise FileNotFoundError(2, os.strerror(2), str(folder))
    lock = file_lock.take(folder)
    try:
        yield lock is not None
    finally:
        if lock is not None:
            lock.release()


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
    def create(cls, path: Path, shape: tuple[int, ...], dtype: Any, index_axes: int) -> Self:
        """Creates a file of zeros of that shape."""
        header, kind = _npy_header(shape, np.dtype(dtype)), np.dtype(dtype)
        with path.open("wb") as stream:
            stream.write(header)
            stream.truncate(len(header) + math.prod(shape) * kind.itemsize)
        return cls.open(path, shape, kind, index_axes)

    @classmethod
    def open(cls, path: Path, shape: tuple[int, ...], dtype: Any, index_axes: int) -> Self:
        """Opens a file of that shape to change it."""
        kind = np.dtype(dtype)
        return cls(os.open(path, os.O_RDWR | CAREFUL), shape, kind, index_axes, len(_npy_header(shape, kind)))

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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _mapped(path: Path, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """A read-only map of an .npy file. Raises DamagedPackError if shape or type differ, OSError."""
    header, count = _npy_header(shape, np.dtype(dtype)), math.prod(shape)
    with open_regular(path) as file:
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
        return shown_as(light_field(folder, read_manifest(folder), hold), half_turn)
    except OSError as error:
        raise damaged(folder, f"no pack: {reason(error)}") from None
    except (ValueError, TypeError, LookupError, OverflowError) as error:
        raise damaged(folder, f"no pack: {error}") from None


def light_field(folder: Path, manifest: dict[str, Any], hold: object = None) -> LightField:
    """The light field of a pack with this manifest. Raises DamagedPackError, OSError, ValueError and others for what
    lfpipe did not write."""
    rows, cols, frames, height, width = (int(manifest[name]) for name in ("rows", "cols", "frames", "height", "width"))
    about = manifest["disparity"]
    disparity = None
    if manifest["complete"] and about["source"] != "none":
        disparity = _mapped(folder / "disparity.npy", (frames, rows, cols, (height + 1) // 2, (width + 1) // 2), np.int8)
    offsets = np.zeros((rows, cols, 2)) if manifest["offsets"] is None else manifest["offsets"]
    return LightField(
        views=_mapped(folder / "views.npy", (frames, rows, cols, int(manifest["channels"]), height, width), np.uint8),
        disparity=disparity,
        disparity_scale_px=about["scale_px"],
        disparity_min_px=about["min_px"],
        disparity_max_px=about["max_px"],
        disparity_source=about["source"],
        offsets=np.asarray(offsets, np.float32).reshape(rows, cols, 2),
        present=np.asarray(manifest["present"], bool).reshape(rows, cols),
        geometry=Geometry(**manifest["geometry"]),
        frame_rate_hz=manifest["frame_rate_hz"],
        name=manifest["name"],
        method=manifest["method"],
        manifest=manifest,
        folder=str(folder),
        hold=hold,
        border_px=(float(about["border_low_px"]), float(about["border_high_px"])),
    )


def summarize(field: LightField) -> SceneSummary:
    """What a session needs to know of an opened pack."""
    known = field.geometry
    return SceneSummary(
        pack=field.folder,
        name=field.name,
        rows=field.rows,
        cols=field.cols,
        height_px=field.height_px,
        width_px=field.width_px,
        method=field.method,
        has_disparity=field.disparity is not None,
        complete=field.complete,
        scores={name: float(score) for name, score in field.manifest["scores"].items()},
        baseline_mm=known.baseline_mm,
        focus_distance_mm=known.focus_distance_mm,
        focal_length_px=known.focal_length_px,
        disparity_min_px=float(field.disparity_min_px),
        disparity_max_px=float(field.disparity_max_px),
        half_turned=field.half_turned,
    )
