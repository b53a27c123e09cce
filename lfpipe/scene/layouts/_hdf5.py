"""HDF5 files that others made: opened read-only, and nothing in them may lead to another file."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError

_WHOLE_BYTES = 1 << 30


class Hdf5:
    """Data sets of one file, read in pieces; safe from several threads."""

    def __init__(self, path: Path) -> None:
        import h5py  # 0.1 s, and only two layouts need it

        self.path = path
        self._lock = threading.Lock()
        self._whole: dict[str, Any] = {}
        try:
            self._file = h5py.File(path, "r")
        except (OSError, ValueError, RuntimeError) as error:
            reason = str(error).splitlines()[0]
            raise UserError(f"{path}: not a readable HDF5 file: {reason}", "fetch it again (a truncated copy?)") from None
        self._h5py = h5py

    def shape(self, key: str) -> tuple[int, ...] | None:
        """Shape of a data set, None where there is none. Raises UserError where it leads out of the file."""
        with self._lock:
            try:
                link = self._file.get(key, getlink=True)
                if isinstance(link, self._h5py.ExternalLink):
                    raise UserError(f"{self.path}: {key} leads to another file, {link.filename}", "fetch the scene as one file")
                item = self._file.get(key)
                if not isinstance(item, self._h5py.Dataset) or item.dtype.kind not in "uif":
                    return None
                if item.external or item.is_virtual:
                    raise UserError(f"{self.path}: {key} is kept in other files", "fetch the whole scene as one file")
                return tuple(int(n) for n in item.shape)
            except (KeyError, OSError, RuntimeError, ValueError, TypeError) as error:
                raise UserError(f"{self.path}: {key} cannot be read: {error}", "fetch the file again") from None

    def type(self, key: str) -> np.dtype[Any]:
        """Number type of a data set that `shape` has found."""
        kind: np.dtype[Any] = self._file[key].dtype
        return kind

    def keys(self) -> list[str]:
        """Names at the root."""
        return sorted(str(name) for name in self._file)

    def attributes(self) -> dict[str, float]:
        """Numeric attributes of the root."""
        found: dict[str, float] = {}
        for name in self._file.attrs:
            try:
                found[str(name)] = float(np.asarray(self._file.attrs[name]).ravel()[0])
            except (TypeError, ValueError, IndexError, OSError):
                continue
        return found

    def piece(self, key: str, index: Any) -> NDArray[Any]:
        """A part of a data set. Raises UserError where the file is damaged there."""
        with self._lock:
            try:
                if key not in self._whole:
                    found = self._file[key]
                    # A view may cross every compressed chunk: unpacking them all once beats doing so for each view.
                    self._whole[key] = found[()] if found.chunks and found.nbytes <= _WHOLE_BYTES else found
                return np.asarray(self._whole[key][index])
            except (OSError, RuntimeError, ValueError, KeyError, IndexError) as error:
                raise UserError(f"{self.path}: {key} is damaged: {str(error).splitlines()[0]}", "fetch the file again") from None


def is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5, as MATLAB's v7.3 is behind a header of its own."""
    import h5py

    return bool(h5py.is_hdf5(path))


def unsigned(values: NDArray[Any], path: Path, full: Callable[[], float] = lambda: 1.0) -> NDArray[Any]:
    """uint8 and uint16 as they are; floats 0 .. full() as uint16 0 .. 65535. Raises UserError for other types, NaN."""
    if values.dtype in (np.uint8, np.uint16):
        return values
    if values.dtype.kind != "f":
        raise UserError(f"{path}: values of type {values.dtype}", "export them as uint8, uint16 or float")
    if not np.isfinite(values).all():
        raise UserError(f"{path}: holds values that are no numbers (NaN or infinite)", "export it again")
    share = np.clip(values.astype(np.float32) / np.float32(full()), 0, 1)
    return np.asarray(np.rint(share * np.float32(65535)), np.uint16)
