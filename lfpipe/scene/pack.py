"""A pack on disk: planar arrays, opened as read-only memory maps, and manifest.json.

- views.npy: uint8 (frames, rows, cols, channels, height, width); locked while a light field of the
  pack is open
- disparity.npy: int8 (frames, rows, cols, half height, half width); only of a complete pack
- manifest.json: written last; "complete": whether all views and the disparity are there

Views are written first: a pack without disparity can be shown.
"""

import contextlib
import json
import os
import weakref
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SceneSummary, converter
from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_regular, open_regular, read_bytes, reason, write_file
from lfpipe.files.untrusted import json_fields
from lfpipe.host.file_lock import lock_open
from lfpipe.host.files import reserve
from lfpipe.scene.inverted_depth import shown_as
from lfpipe.scene.lightfield import VERSION, DisparitySource, LightField, Manifest

VIEWS, DISPARITY, MANIFEST = "views.npy", "disparity.npy", "manifest.json"
INTERIM = "interim.npy"  # while the disparity is estimated


class DamagedPackError(UserError):
    """A folder that is not a pack of this version, or is damaged."""


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Writes the manifest atomically. Raises OSError."""
    text = json.dumps(attrs.asdict(manifest), indent=1, allow_nan=False)
    write_file(folder / MANIFEST, text.encode(), 0o666)


@contextlib.contextmanager
def _reading(folder: Path) -> Iterator[None]:
    """Turns any exception of reading a pack, perhaps not lfpipe's own, into DamagedPackError."""
    try:
        yield
    except DamagedPackError:
        raise
    except (UserError, OSError, ValueError, TypeError, LookupError, OverflowError) as error:
        why = reason(error) if isinstance(error, OSError) else str(error)
        raise DamagedPackError(
            f"{folder}: not a usable pack: {why}", "make it again with `lfpipe scene pack`"
        ) from None


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a pack.

    Raises DamagedPackError if it is missing, damaged or of another version.
    """
    with _reading(folder):
        # the manifest of 20,000 views with offsets has about 1 MB
        manifest = json_fields(read_bytes(folder / MANIFEST, 16 << 20), MANIFEST, "").values
        if manifest.get("version") != VERSION:
            raise ValueError(f"it has another version; this lfpipe reads version {VERSION}")
        return converter().structure(manifest, Manifest)


def make_array(
    path: Path, shape: tuple[int, ...], dtype: Any = np.uint8
) -> Callable[[], NDArray[Any]]:
    """Makes an .npy file of zeros and allocates its disk space: a full disk raises OSError now, not
    a signal (SIGBUS) later.
    """
    np.lib.format.open_memmap(path, "w+", dtype, shape)
    reserve(path)
    return mapper(path)


def mapper(path: Path) -> Callable[[], NDArray[Any]]:
    """A function that maps the array of an .npy file for reading and writing in any thread. Call it
    for every block: touched pages count as memory of the process as long as the map exists.
    """
    # once: parsing a header in two threads occasionally fails (Python 3.11.7)
    array = np.lib.format.open_memmap(path, "r+")
    return partial(np.memmap, path, array.dtype, "r+", array.offset, array.shape)


def _mapped(path: Path, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """A read-only map of an .npy file. Raises OSError, and ValueError for another type or shape."""
    check_regular(path)
    array = np.lib.format.open_memmap(path, mode="r")
    if array.shape != shape or array.dtype != dtype or not array.flags.c_contiguous:
        raise ValueError(f"{path.name} is not an array of {np.dtype(dtype)} {shape}")
    return np.asarray(array)


def hold_pack(folder: Path) -> int:
    """An open descriptor of a pack: `lfpipe scene clean` does not remove the pack until it is
    closed.

    Raises OSError, and ValueError if the pack is being removed.
    """
    with open_regular(folder / VIEWS) as file:
        locked = lock_open(file.fileno(), shared=True)
        if not locked or not os.path.samestat(os.fstat(file.fileno()), (folder / VIEWS).stat()):
            raise ValueError("it is being removed")
        return os.dup(file.fileno())  # shares the lock


def open_pack(folder: Path, invert_depth: str = "auto") -> LightField:
    """The light field of a pack, in the order that scene.invert_depth asks for. `lfpipe scene
    clean` does not remove the pack while this object lives.

    Raises DamagedPackError if it is missing, damaged or of another version.
    """
    with _reading(folder), contextlib.ExitStack() as undo:
        held = hold_pack(folder)
        undo.callback(os.close, held)
        field = light_field(folder, read_manifest(folder))
        undo.pop_all()
        # held as long as the map of the views lives
        hold = weakref.finalize(field.views.base, os.close, held)
        return shown_as(attrs.evolve(field, hold=hold), invert_depth)


def light_field(folder: Path, manifest: Manifest) -> LightField:
    """The light field of a pack with this manifest.

    Raises OSError, ValueError and others if lfpipe did not write it.
    """
    disparity = None
    if manifest.complete and manifest.disparity.source is not DisparitySource.NONE:
        disparity = _mapped(folder / DISPARITY, manifest.disparity_shape, np.int8)
    return LightField.of(
        manifest,
        _mapped(folder / VIEWS, manifest.views_shape, np.uint8),
        disparity,
        folder=str(folder),
    )


def summarize(field: LightField) -> SceneSummary:
    """The summary of an opened pack for a session."""
    same = (
        *("name", "frames", "rows", "cols", "height_px", "width_px"),
        *("method", "complete", "depth_inverted", "needs_eyes"),
    )
    return SceneSummary(
        pack=field.folder,
        has_disparity=field.disparity is not None,
        scores=field.manifest.scores,
        errors=field.manifest.errors,
        disparity_min_px=field.disparity_min_px,
        disparity_max_px=field.disparity_max_px,
        **{name: getattr(field, name) for name in same},
    )
