"""HDF5 files: opened read-only, links to other files refused. The packer's limits on memory and time bound what damage costs."""

import contextlib
import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.files import descriptor_path, open_file

_WHOLE_BYTES = 1 << 30  # a compressed data set up to this size is unpacked in one go
_REMEDY = "fetch the file again"
# What h5py raises for damage, besides MemoryError.
_TROUBLE = (OSError, RuntimeError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError)


class Hdf5:
    """Data sets of one file, read in pieces; safe from several threads."""

    def __init__(self, path: Path) -> None:
        import h5py  # 0.1 s, and only two layouts need it

        self.path = path
        self._lock = threading.Lock()
        self._whole: dict[str, Any] = {}
        with open_file(path) as file:
            try:
                self._file = h5py.File(descriptor_path(file), "r")
            except _TROUBLE as error:
                raise UserError(f"{path}: not a readable HDF5 file: {_first_line(error)}", "download it again") from None
        self._h5py = h5py

    def shape(self, key: str) -> tuple[int, ...] | None:
        """Shape of a numeric data set, None if there is none. Raises UserError if it leads out of the file."""
        with self._guarded(key):
            link = self._file.get(key, getlink=True)
            if isinstance(link, self._h5py.ExternalLink | self._h5py.SoftLink):  # a chain of them may end anywhere
                there = getattr(link, "filename", "") or link.path
                raise UserError(f"{self.path}: {key} links to another file or place, {there}", "download the scene as one file")
            item = self._file.get(key)
            if not isinstance(item, self._h5py.Dataset) or item.dtype.kind not in "uif" or item.shape is None:
                return None
            if item.external or item.is_virtual:
                raise UserError(f"{self.path}: {key} is stored in other files", "download the whole scene as one file")
            return tuple(int(n) for n in item.shape)

    @contextlib.contextmanager
    def _guarded(self, what: str) -> Iterator[None]:
        """One thread at a time; h5py's errors for damage become UserError."""
        with self._lock:
            try:
                yield
            except _TROUBLE as error:
                raise UserError(f"{self.path}: {what} cannot be read: {_first_line(error)}", _REMEDY) from None

    def type(self, key: str) -> np.dtype[Any]:
        """Number type of a data set that `shape` has found."""
        with self._guarded(key):
            kind: np.dtype[Any] = self._file[key].dtype
            return kind

    def keys(self) -> list[str]:
        """Names at the root."""
        with self._guarded("its root"):
            return sorted(str(name) for name in self._file)

    def attributes(self) -> dict[str, float]:
        """Numeric attributes of the root, without arrays."""
        found: dict[str, float] = {}
        with self._guarded("the attributes"):
            attrs = self._file.attrs
            for name in attrs:
                about = attrs.get_id(name)
                if about.dtype.kind in "uif" and math.prod(about.shape) == 1:
                    found[str(name)] = float(np.asarray(attrs[name]).ravel()[0])
        return found

    def piece(self, key: str, index: Any) -> NDArray[Any]:
        """A part of a data set that `shape` has found. Raises UserError if the file is damaged there."""
        with self._guarded(key):
            if key not in self._whole:
                found = self._file[key]
                if found.chunks:
                    whole = math.prod(-(-size // chunk) * chunk for size, chunk in zip(found.shape, found.chunks, strict=True))
                    stored = found.id.get_storage_size()
                    if stored > whole * found.dtype.itemsize * 1.1 + 1024:  # it would unpack to more than it says
                        raise ValueError(f"{stored} bytes are stored for {whole} values")
                # a view may cross every compressed chunk: unpacking all of them once beats unpacking for each view
                if found.chunks and found.nbytes <= _WHOLE_BYTES:
                    found = found[()]
                self._whole[key] = found
            return np.asarray(self._whole[key][index])


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5, like MATLAB's v7.3 after its own header. Raises UserError if it cannot be read."""
    import h5py

    with open_file(path) as file:
        try:
            return bool(h5py.is_hdf5(descriptor_path(file)))
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {_first_line(error)}", _REMEDY) from None


def unsigned(values: NDArray[Any], path: Path, full: Callable[[], float] = lambda: 1.0) -> NDArray[Any]:
    """uint8 and uint16 unchanged; floats 0 .. full() as uint16 0 .. 65535. Raises UserError for other types, NaN."""
    if values.dtype in (np.uint8, np.uint16):
        return values
    if values.dtype.kind != "f":
        raise UserError(f"{path}: values of type {values.dtype}", "export them as uint8, uint16 or float")
    if not np.isfinite(values).all():
        raise UserError(f"{path}: contains NaN or infinite values", "export it again")
    with np.errstate(over="ignore"):
        share = np.clip(values.astype(np.float32) / np.float32(full()), 0, 1)
    return np.asarray(np.rint(share * np.float32(65535)), np.uint16)
