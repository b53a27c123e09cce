"""Light fields in one array: NumPy's .npy and .npz, MATLAB's .mat, and lf.h5 of the first HCI data
set.

Axes are (rows, cols, height, width, planes), in NumPy files perhaps with frames before them; planes
are 1 (grey) or 3 (red first). Values are uint8, uint16, or float up to 1, 255 or 65535. An .npz
contains `views`, optionally `disparity` (rows, cols, height, width), px per view, nearer is larger,
and `positions` (rows, cols, 2), the camera positions, (down, right) in any unit. MATLAB files
contain LF: LFToolbox's NAME__Decoded.mat and BasicLFSR's. v7.3 files are HDF5, with all axes in
reverse order; older ones need scipy (the extra `scipy`). lf.h5 contains LF, GT_DEPTH and
attributes, columns from right to left: Wanner, Meister, Goldluecke, "Datasets and Benchmarks for
Densely Sampled 4D Light Fields", VMV 2013. In a file without those attributes, columns may run
either way.

ESLF, of plenoptic cameras: one PNG, with `eslf` in its name, of lenslets of N x N px (14 x 14 for a
Lytro Illum; else scene.grid), as in LFToolbox's LFReadESLF; pixel (row, col) of every lenslet forms
one view. The outer views are dark or empty.
"""

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError, plain
from lfpipe.files.pictures import read_picture
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import proc_fd_path
from lfpipe.host.worker import install_command
from lfpipe.scene.layouts._grid import (
    coordinate_turn,
    parse_grid,
    require_grid,
    require_picture,
    require_view,
    single_picture,
)
from lfpipe.scene.layouts._names import ESLF, is_map, words
from lfpipe.scene.source import GridTransform, Layout, Listing, SceneSource, ViewIndex

# brightness over that of the middle view; darker sides and views are left out
_DARK_SIDE, _DARK_VIEW = 0.55, 0.4


def without_dark_sides(source: SceneSource) -> SceneSource:
    """The source without its dark sides, evenly from both ends; dark views in the corners count as
    missing.
    """

    def light(row: int, col: int) -> float:
        return (
            0.0
            if (row, col) in source.missing
            else float(source.read(0, row, col)[::4, ::4].mean())
        )

    all_rows, all_cols = source.rows, source.cols
    middle = light(all_rows // 2, all_cols // 2)
    least = _DARK_SIDE * middle
    top = next(
        k
        for k in range(all_rows)
        if all_rows - 2 * k <= 2
        or min(light(row, all_cols // 2) for row in (k, all_rows - 1 - k)) >= least
    )
    left = next(
        k
        for k in range(all_cols)
        if all_cols - 2 * k <= 2
        or min(light(all_rows // 2, col) for col in (k, all_cols - 1 - k)) >= least
    )
    rows, cols = all_rows - 2 * top, all_cols - 2 * left
    missing: set[ViewIndex] = set()
    for row, col in np.ndindex(rows, cols):
        # brightness falls off only towards the corners: no need to check the rest of the grid
        corner = min(row, rows - 1 - row) + min(col, cols - 1 - col) < max(1, min(rows, cols) // 4)
        if (row + top, col + left) in source.missing or (
            corner and light(row + top, col + left) < _DARK_VIEW * middle
        ):
            missing.add((row, col))
    note = f"the central {rows}x{cols} of {all_rows}x{all_cols} views are used; the others are dark"
    small = source.small
    return attrs.evolve(
        source,
        rows=rows,
        cols=cols,
        missing=frozenset(missing),
        notes=(*source.notes, note) if top or left else source.notes,
        read=lambda frame, row, col: source.read(frame, row + top, col + left),
        small=None
        if small is None
        else lambda row, col, most_px: small(row + top, col + left, most_px),
    )


def _describe_eslf(listing: Listing, scene: config.Scene) -> SceneSource:
    path = require_picture(listing)
    picture, full = read_picture(path)
    rows, cols = parse_grid(scene.grid) or (14, 14)  # a Lytro Illum's
    below, beside = -picture.shape[0] % rows, -picture.shape[1] % cols
    if below or beside:  # LFToolbox pads at the end
        picture = cv2.copyMakeBorder(picture, 0, below, 0, beside, cv2.BORDER_CONSTANT)
    return without_dark_sides(
        SceneSource(
            layout="eslf",
            path=listing.path,
            files=(path,),
            rows=rows,
            cols=cols,
            read=lambda frame, row, col: np.ascontiguousarray(picture[row::rows, col::cols]),
            height_px=picture.shape[0] // rows,
            width_px=picture.shape[1] // cols,
            max_value=full,
            turn=GridTransform(),
            turn_firm=False,
            turn_by="an ESLF picture counts rows from the top and columns from the left",
        )
    )


VIEWS, DISPARITY, POSITIONS = "views", "disparity", "positions"
AXES = "(rows, cols, height, width, 1 or 3), or (frames, rows, cols, height, width, 1 or 3)"
_KEYS = ("LF", "lf", "LightField", "lightfield")
# limits of camera parameters in files, mm or px: values beyond them, and NaN, count as unknown
LARGEST = 1e9


def _require_size(kind: np.dtype[Any], shape: tuple[int, ...], what: str) -> None:
    """Raises UserError for values of another type, or if the array is too large for a light field.

    what: its name, for messages.
    """
    if kind.newbyteorder("=") not in (np.uint8, np.uint16) and kind.kind != "f":
        raise UserError(
            f"{what}: values of type {kind}", "save it as uint8, uint16 or float 0 .. 1"
        )
    rows, cols, height, width = shape
    require_grid(rows, cols, what)
    require_view(height, width, kind.itemsize, what)


def require_views(views: NDArray[Any], what: str) -> NDArray[Any]:
    """views as (frames, rows, cols, height, width, 1 or 3). Copies nothing.

    Raises UserError for other axes and types. what: its name, for messages.
    """
    coloured = views[..., None] if views.ndim == 4 else views
    framed = coloured[None] if coloured.ndim == 5 else coloured
    if framed.ndim != 6 or framed.shape[-1] not in (1, 3) or framed.shape[0] < 1:
        raise UserError(f"{what}: axes of sizes {views.shape}", f"save it with the axes {AXES}")
    _require_size(views.dtype, framed.shape[1:5], what)
    return framed


def _source(
    layout: str,
    path: Path,
    listing: Listing,
    shape: tuple[int, ...],
    kind: np.dtype[Any],
    raw: Callable[[int, int, int], NDArray[Any]],
    **more: Any,
) -> SceneSource:
    """The views of an array. shape: rows, cols, height and width; kind: type of the values;
    raw(frame, row, col): a view as stored, with or without planes; more: further fields of
    SceneSource.
    """
    rows, cols, height, width = shape
    middle = raw(0, rows // 2, cols // 2)
    # filter overshoot is slightly below 0, too
    if kind.kind == "f" and np.mean(middle < -0.02) > 0.01:
        raise UserError(
            f"{path}: values below 0, down to {np.min(middle):.3g}",
            "scale them to 0 .. 1: (views - low) / (high - low)",
        )
    # few highlights of a rendering are above 1 or 255, too
    fits = (full for full in (1.0, 255.0) if np.mean(middle > 1.5 * full) <= 0.1)
    full = next(fits, 65535.0)

    def read(frame: int, row: int, col: int) -> NDArray[Any]:
        pixels = raw(frame, row, col)
        if pixels.ndim == 3:  # a fourth plane contains LFToolbox's weights
            pixels = pixels[..., 0] if pixels.shape[2] < 3 else pixels[..., :3]
        if kind.kind == "f":
            if not np.isfinite(pixels).all():
                raise UserError(f"{path}: contains NaN or infinite values", "export it again")
            # clipped first: float32 holds less than float64
            pixels = np.clip(pixels, 0, full).astype(np.float32)
            pixels = np.rint(pixels / np.float32(full) * np.float32(65535)).astype(np.uint16)
        return np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("="))

    return SceneSource(
        layout=layout,
        path=listing.path,
        files=(path,),
        rows=rows,
        cols=cols,
        read=read,
        height_px=height,
        width_px=width,
        max_value=255 if kind == np.uint8 else 65535,
        **more,
    )


def _numpy_arrays(path: Path) -> Mapping[str, NDArray[Any]]:
    """The arrays of a file by name. Raises UserError."""
    with damage(
        path, "not a readable array", "save it with numpy.save or numpy.savez, without objects"
    ):
        open_file(path).close()  # which is opened by its path to be mapped
        if path.suffix.lower() == ".npy":
            return {VIEWS: np.load(path, mmap_mode="r", allow_pickle=False)}
        with np.load(path, allow_pickle=False) as archive:
            names = [name for name in (VIEWS, DISPARITY, POSITIONS) if name in archive.files]
            names = names or archive.files[:1] * (len(archive.files) == 1)
            return {
                # a member that is not an array is returned as bytes
                name if name in (DISPARITY, POSITIONS) else VIEWS: np.asarray(archive[name])
                for name in names
            }


def _numpy_source(listing: Listing, path: Path) -> SceneSource:
    arrays = _numpy_arrays(path)
    if VIEWS not in arrays:
        raise UserError(
            f"{path}: no array {VIEWS!r}",
            f"save it by numpy.savez(FILE, {VIEWS}=...), with the axes {AXES}",
        )
    views = require_views(arrays[VIEWS], str(path))
    frames, rows, cols = views.shape[:3]
    disparity, positions = arrays.get(DISPARITY), arrays.get(POSITIONS)
    for name, values, shape in (
        (DISPARITY, disparity, views.shape[1:5]),
        (POSITIONS, positions, (rows, cols, 2)),
    ):
        if values is not None and (values.shape != shape or values.dtype.kind not in "fiu"):
            raise UserError(
                f"{path}: {name} has sizes {values.shape}", f"give numbers of the sizes {shape}"
            )
    if positions is not None and not np.isfinite(positions).all():
        raise UserError(
            f"{path}: {POSITIONS} contains NaN or infinite values", "give finite numbers"
        )

    camera_positions = None if positions is None else np.asarray(positions, np.float64)
    turn = None if camera_positions is None else coordinate_turn(camera_positions)
    truth = (
        {}
        if disparity is None
        else {
            place: partial(np.asarray, disparity[place], np.float32)
            for place in itertools.product(range(rows), range(cols))
        }
    )
    return _source(
        "array",
        path,
        listing,
        views.shape[1:5],
        views.dtype,
        lambda frame, row, col: np.asarray(views[frame, row, col]),
        frames=frames,
        frame_rate_hz=30.0 if frames > 1 else 0.0,
        turn=turn or GridTransform(),
        turn_firm=False,
        turn_by=(
            "positions of the cameras"
            if turn
            else "rows of the array are counted from the top, columns from the left"
        ),
        coordinates=camera_positions,
        truth=truth,
    )


@contextlib.contextmanager
def damage(path: Path, what: str, remedy: str = "fetch the file again") -> Iterator[None]:
    """Turns any exception of a parser into UserError."""
    try:
        yield
    except (UserError, MemoryError):
        raise
    except Exception as error:
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise UserError(f"{path}: {what}: {why}"[:1000], remedy) from None


def _hdf5(path: Path) -> Any:
    """The h5py.File at path. Raises UserError."""
    import h5py  # 0.1 s, and only two layouts need it

    with open_file(path) as file, damage(path, "not a readable HDF5 file"):
        return h5py.File(proc_fd_path(file), "r")


def _names(path: Path, file: Any) -> list[str]:
    """The names of a file's first objects; those that are not UTF-8 are bytes in h5py."""
    with damage(path, "the names of its arrays cannot be read"):
        return [
            plain(name if isinstance(name, str) else repr(name), 100)
            for name in itertools.islice(file, 100)
        ]


def _hdf5_array(path: Path, file: Any, *keys: str) -> Any:
    """The first of these numeric arrays in a file: an array, or a data set that reads like one;
    None if there is none. Raises UserError if it links to another file.
    """
    import h5py

    for key in keys:
        with damage(path, f"{key} cannot be read"):
            # a chain of links may end anywhere
            linked = isinstance(file.get(key, getlink=True), h5py.ExternalLink | h5py.SoftLink)
            data = None if linked else file.get(key)
            if linked or (isinstance(data, h5py.Dataset) and (data.external or data.is_virtual)):
                raise UserError(
                    f"{path}: {key} is stored in another file",
                    "download the whole scene as one file",
                )
            if (
                not isinstance(data, h5py.Dataset)
                or data.dtype.kind not in "uif"
                or data.shape is None
            ):
                continue
            if not data.chunks:
                return data
            whole = math.prod(
                -(-size // chunk) * chunk
                for size, chunk in zip(data.shape, data.chunks, strict=True)
            )
            stored = data.id.get_storage_size()
            # decompression bomb
            if stored > whole * data.dtype.itemsize * 1.1 + 1024:
                raise UserError(
                    f"{path}: {key}: {stored} bytes are stored for {whole} values",
                    "fetch the file again",
                )
            # a view may cross every compressed chunk: decompressing all once is faster than doing
            # so for each view
            return data[()] if data.nbytes <= 1 << 30 else data
    return None


def _ordered_source(
    layout: str, listing: Listing, path: Path, array: Any, names: list[str], reverse: bool = False
) -> SceneSource:
    """The views of an array, or of an HDF5 data set, with the axes (rows, cols, height, width[,
    planes]), or in reverse order. names: of all arrays in the file, for the message if LF is
    missing. Raises UserError.
    """
    if array is None:
        raise UserError(
            f"{path}: no array LF (it contains: {', '.join(names[:8])})",
            "save the light field as LF",
        )
    shape = tuple(int(size) for size in (array.shape[::-1] if reverse else array.shape))
    # planes: grey, colour, or colour with weights
    if len(shape) not in (4, 5) or shape[4:] not in ((), (1,), (3,), (4,), (5,)):
        raise UserError(
            f"{path}: LF has {len(shape)} axes of sizes {shape}", f"save it with the axes {AXES}"
        )
    _require_size(array.dtype, shape[:4], f"{path}: LF")
    return _source(
        layout,
        path,
        listing,
        shape[:4],
        array.dtype,
        lambda frame, row, col: (
            np.asarray(array[..., col, row]).T if reverse else np.asarray(array[row, col])
        ),
    )


def matlab_array(path: Path, *keys: str) -> tuple[Any, list[str], bool]:
    """The first of these arrays of a file, or its first at all, the names of its variables, and
    whether its axes are in reverse order, as in HDF5. Raises UserError.
    """
    import h5py

    with open_file(path) as file:
        if h5py.is_hdf5(proc_fd_path(file)):  # v7.3, after MATLAB's own header
            data = _hdf5(path)
            names = _names(path, data)
            return _hdf5_array(path, data, *(keys or names)), names, True
        try:
            import scipy.io
        except ImportError:
            raise UserError(
                f"{path}: a .mat file older than v7.3 needs scipy",
                f"{install_command('scipy')}, or save it with -v7.3",
            ) from None
        with damage(path, "not a readable .mat file", "save it again, with -v7.3"):
            names = [name for name, _, _ in scipy.io.whosmat(file)]
            file.seek(0)
            keys = keys or tuple(names)
            arrays = scipy.io.loadmat(file, variable_names=keys)
    return next((np.asarray(arrays[key]) for key in keys if key in arrays), None), names, False


def _matlab_source(listing: Listing, path: Path) -> SceneSource:
    array, names, reverse = matlab_array(path, *_KEYS)
    source = without_dark_sides(_ordered_source("mat", listing, path, array, names, reverse))
    if not {"LFMetadata", "DecodeOptions", "RectOptions", "WhiteImageMetadata"} & set(names):
        return source
    return attrs.evolve(
        source,
        linear=True,
        turn=GridTransform(),
        turn_by="LFToolbox counts rows from the top and columns from the left",
        turn_firm=False,
    )


def disparity_of_depth(
    depth: NDArray[np.float32], camera: Mapping[str, float]
) -> NDArray[np.float32]:
    """Disparity in px per view from depth as the first HCI data set has it:
    dH * focalLength / depth - shift.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        unit = np.float32(camera.get("dH", 0.0) * camera.get("focalLength", 0.0))
        return np.asarray(unit / depth - np.float32(camera.get("shift", 0.0)), np.float32)


def _hci_old_source(listing: Listing, path: Path) -> SceneSource:
    file = _hdf5(path)
    names = _names(path, file)
    source = _ordered_source("hci-old", listing, path, _hdf5_array(path, file, *_KEYS), names)
    with damage(path, "the attributes cannot be read"):
        values = {
            name: float(np.ravel(file.attrs[name])[0])
            for name in ("dH", "focalLength", "shift")
            if name in file.attrs  # by type and shape: nothing large is read
            and (stored := file.attrs.get_id(name)).dtype.kind in "uif"
            and stored.shape in ((), (1,))
        }
    camera = {name: value for name, value in values.items() if abs(value) <= LARGEST}
    depth = _hdf5_array(path, file, "GT_DEPTH")
    if not values:  # written by another program
        return source
    truth = {}
    shape = source.rows, source.cols, source.height_px, source.width_px
    if (
        depth is not None
        and depth.shape == shape
        and camera.get("dH")
        and camera.get("focalLength")
    ):
        truth = {
            place: lambda at=place: disparity_of_depth(depth[at].astype(np.float32), camera)
            for place in source.places
        }
    return attrs.evolve(
        source,
        truth=truth,
        turn=GridTransform(cols=True),
        turn_by="the columns of lf.h5 run from right to left",
    )


def _layout(
    name: str, ends: tuple[str, ...], source: Callable[[Listing, Path], SceneSource]
) -> Layout:
    """The layout of scenes in one file with one of these suffixes."""

    def only(listing: Listing) -> Path | None:
        names = [
            file
            for file in listing.names
            if file.lower().endswith(ends)
            and (listing.is_file or (ends[0] != ".npy" and not is_map(file)))
        ]
        names = ["lf.h5"] if "lf.h5" in names else names
        return listing.file(names[0]) if len(names) == 1 else None

    def describe(listing: Listing, scene: config.Scene) -> SceneSource:
        if (path := only(listing)) is None:
            raise UserError(
                f"{listing.path}: contains no {ends[0]} file, or several",
                "give the file itself by its own path",
            )
        return source(listing, path)

    return Layout(name, lambda listing: None if only(listing) is None else 90, describe)


LAYOUTS = (
    _layout("array", (".npy", ".npz"), _numpy_source),
    _layout("mat", (".mat",), _matlab_source),
    _layout("hci-old", (".h5", ".hdf5"), _hci_old_source),
    Layout(
        "eslf",
        lambda listing: (
            90 if (path := single_picture(listing)) and ESLF.search(words(path.name)) else None
        ),
        _describe_eslf,
    ),
)
