"""A picture with its depth map: side by side or one below the other in one file (Looking Glass
RGB-D), in two files, or inside a JPEG as phones write it.

Views around the picture are rendered from it: shifted by depth, holes filled from behind.
"""

from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture, upright
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import proc_fd_path
from lfpipe.scene.layouts._grid import (
    halves,
    parse_grid,
    require_grid,
    require_picture,
    single_picture,
    some,
)
from lfpipe.scene.layouts._names import (
    DEPTH,
    INVERSE,
    RECORDED,
    RGBD,
    VIEWS,
    is_map,
    pairs,
    read_names,
    words,
)
from lfpipe.scene.layouts._stated import embedded_depth
from lfpipe.scene.layouts.arrays import damage, matlab_array
from lfpipe.scene.packing import nearest, warped_disparity, warped_view
from lfpipe.scene.source import GridTransform, Listing, SceneSource, is_picture, read_pfm

NAME = "rgbd"
HDF5 = (".mat", ".h5", ".hdf5")
MAP_ENDS = (".npy", ".npz", ".pfm", ".exr", *HDF5)  # of maps that are no pictures
_MAX_PX = 700_000  # of the rendered views: 45 of them are packed in ten seconds
_SAME_SHAPE = 1.2  # maximum ratio of the aspects of a picture and its depth map
COLOURED = 6.0  # levels between channels: fewer in a depth map, more in a picture
LOWER = 0.35  # significant correlation of height with nearness
DISPARITY = 0.008  # per view, between the nearest and the farthest, as a share of the width
_LEFT_OPEN = "press d in the window, or set scene.invert_depth=yes, if the depth looks inverted"
_FRAMES = (
    "whether the numbered pictures are frames of one camera"
    " (--set scene.layout=numbered opens them as views)"
)


@attrs.frozen(eq=False, kw_only=True)
class _Photo:
    """A picture with its depth map."""

    paths: tuple[Path, ...]
    picture: NDArray[Any]
    full: int  # full-scale value of the picture
    nearness: NDArray[np.float32]  # (h, w), larger is nearer, NaN for unmeasured pixels
    why: str  # the interpretation of the map
    doubt: str = ""  # any ambiguity left


def read_depth(
    stored: NDArray[Any], name: str, by_format: bool = False
) -> tuple[NDArray[np.float32], str, str]:
    """(nearness, why, doubt), as in `_Photo`, of a stored depth map, (h, w).

    Values of 16 bits or floats that do not span the whole range are distances: near is small. In
    other maps white is near, unless lower parts, which usually are nearer, are darker. What is 0,
    negative or not finite was not measured, but for the black of a map in which white is near.
    by_format: the format defines white as near.
    """
    with np.errstate(over="ignore"):
        values = stored.astype(np.float32)
    values[~np.isfinite(values)] = np.nan
    measured = np.where(values > 0, values, np.float32(np.nan))
    if by_format:
        return values, "white is near", ""
    if INVERSE.search(words(name)):
        return measured, "white is near", ""
    if stored.dtype.itemsize > 1 and not _stretched(stored):
        if stored.dtype.kind != "f":
            measured[stored == _full(stored)] = np.nan
        near = np.asarray(1 / measured, np.float32)
        against = _lower_is_nearer(near) < -LOWER
        if against and stored.dtype.kind == "f":  # as networks write it
            doubt = f"whether near is large in the depth map, as lower parts are; {_LEFT_OPEN}"
            return (
                measured,
                "near is large in the depth map: lower parts have larger values",
                doubt,
            )
        doubt = "whether the depth map contains distances: lower parts would be farther"
        return (
            near,
            "near is small in the depth map, as in distances; 0 was not measured",
            f"{doubt}; {_LEFT_OPEN}" if against else "",
        )
    for hole in (0, _full(stored)):
        if _scattered(stored == hole):
            values = measured = np.where(stored == hole, np.float32(np.nan), measured)
    lower = _lower_is_nearer(values)
    if lower < -LOWER:
        what = f"whether black is near in the depth map: lower parts are darker; {_LEFT_OPEN}"
        return -measured, "black is near: lower parts of the depth map are darker", what
    doubt = f"whether white is near in the depth map; {_LEFT_OPEN}"
    return values, "white is near", "" if lower > LOWER else doubt


def _scattered(holes: NDArray[np.bool_]) -> bool:
    """Whether pixels are holes in what is around them, not a region of the picture."""
    solid = cv2.erode(holes.astype(np.uint8), np.ones((5, 5), np.uint8))
    return bool(2 * np.count_nonzero(solid) < np.count_nonzero(holes))


def _stretched(stored: NDArray[Any]) -> bool:
    """Whether a map uses its whole range of values, which distances do not. A full value far above
    all others means that they were too far.
    """
    full = _full(stored)
    inner = stored[(stored > 0) & (stored < full)]
    ends = float(np.nanmin(stored)) == 0 and float(np.nanmax(stored)) == full
    return ends and inner.size > 0 and float(inner.max()) > 0.25 * full


def _full(stored: NDArray[Any]) -> float:
    return 1.0 if stored.dtype.kind == "f" else float(np.iinfo(stored.dtype).max)


def _lower_is_nearer(nearness: NDArray[np.float32]) -> float:
    """Correlation of height in the picture with nearness: positive if lower parts are nearer."""
    small = nearness[:: max(1, nearness.shape[0] // 200), :: max(1, nearness.shape[1] // 200)]
    y = np.broadcast_to(np.arange(small.shape[0])[:, None], small.shape)
    use = np.isfinite(small)
    if use.sum() < 100 or float(small[use].std()) < 1e-9:
        return 0.0
    return float(np.corrcoef(y[use], small[use])[0, 1])


def _pairs(listing: Listing) -> list[tuple[str, str]]:
    """The names of pictures and of their depth maps: of one picture, or of a recording. Of views,
    each may have a map of its own.
    """
    names = [
        name
        for name in listing.names
        if is_picture(listing.folder / name)
        or (name.lower().endswith(MAP_ENDS) and DEPTH.search(words(name)))
    ]
    maps = [name for name in names if DEPTH.search(words(name))]
    others = [name for name in names if not is_map(name)]
    if len(others) == len(maps) == 1:
        return [(others[0], maps[0])]
    both = [] if listing.is_file else pairs(names)
    counted = read_names(tuple(first for first, _ in both)) if len(both) > 1 else None
    recorded = counted is None or (
        counted.runs
        and all(
            RECORDED.search(words(first)) or not VIEWS.search(words(first)) for first, _ in both
        )
    )
    return both if recorded else []


def read_map(path: Path) -> NDArray[Any]:
    """A map of depth or disparity as it is stored, (h, w). Raises UserError."""
    ending = path.suffix.lower()
    values: Any = None
    if ending in (".npy", ".npz"):
        with damage(path, "not a readable array", "save it with numpy.save, without objects"):
            open_file(path).close()
            stored = np.load(path, allow_pickle=False)
            values = stored if ending == ".npy" else stored[stored.files[0]]
    elif ending == ".pfm":
        values = read_pfm(path)
    elif ending in HDF5:
        values, _, reverse = matlab_array(path)
        values = np.asarray(values).T if reverse and ending == ".mat" else values
    elif ending in (".tif", ".tiff", ".exr"):  # floats, which are no picture
        with open_file(path) as file:
            values = cv2.imread(proc_fd_path(file), cv2.IMREAD_UNCHANGED)
    if ending == ".exr" and values is None:
        raise UserError(
            f"{path}: OpenEXR is not read here", f"save the map as {path.stem}.npy, .pfm or .tif"
        )
    if values is None or (ending.startswith(".tif") and values.dtype.kind != "f"):
        values = read_picture(path)[0]
        if colour_levels(values) > COLOURED:
            raise UserError(
                f"{path}: the depth map has false colours",
                "save it in grey, with near parts white",
            )
    values = np.squeeze(np.asarray(values))
    values = values[..., min(1, values.shape[2] - 1)] if values.ndim == 3 else values
    if values.ndim != 2 or values.dtype.kind not in "uif":
        raise UserError(
            f"{path}: an array of the sizes {values.shape}, not a map", "save one of two axes"
        )
    return np.asarray(values)


def colour_levels(picture: NDArray[Any]) -> float:
    """Difference between the channels of a picture, in levels of 8 bits."""
    if picture.ndim == 2:
        return 0.0
    small = cv2.resize(picture, (64, 64), interpolation=cv2.INTER_AREA).astype(np.float32)
    return float(np.percentile(np.ptp(small, axis=2), 90)) / (
        257 if picture.dtype == np.uint16 else 1
    )


def _beside(picture: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]] | None:
    """(picture, depth) of a file with both: the grey half is the depth map; None without one."""
    if picture.ndim == 2:
        return None
    for first, second in (halves(picture, above=False), halves(picture, above=True)):
        for image, depth in ((first, second), (second, first)):
            if colour_levels(depth) < COLOURED < colour_levels(image):
                return image, depth
    return None


def detect(listing: Listing) -> int | None:
    if _pairs(listing):
        return 84
    path = single_picture(listing)
    if path is not None and embedded_depth(path) is not None:
        return 87
    if path is None or not RGBD.search(words(path.name)):
        return None
    return None if _beside(read_picture(path)[0]) is None else 88


def _read(listing: Listing) -> _Photo:
    """Raises UserError."""
    if recorded := _pairs(listing):
        paths = tuple(listing.file(name) for name in recorded[0])
        picture, full = read_picture(paths[0])
        near, why, doubt = read_depth(read_map(paths[1]), recorded[0][1])
        if len(recorded) > 1:
            doubt = "; ".join(filter(None, (_FRAMES, doubt)))
        return _Photo(paths=paths, picture=picture, full=full, nearness=near, why=why, doubt=doubt)
    path = require_picture(listing)
    picture, full = read_picture(path)
    if (depth := embedded_depth(path)) is not None:
        return _Photo(
            paths=(path,),
            picture=picture,
            full=full,
            nearness=np.asarray(upright(depth, open_header(path).orientation), np.float32),
            why="depth from the photograph's own depth map",
        )
    both = _beside(picture)
    if both is None:
        raise UserError(
            f"{path}: neither half is a grey depth map beside a coloured picture",
            "give picture and depth side by side, or as x.png and x_depth.png in a folder of"
            " their own",
        )
    near, why, doubt = read_depth(both[1][..., 1], path.name, by_format=True)
    return _Photo(paths=(path,), picture=both[0], full=full, nearness=near, why=why, doubt=doubt)


def _disparity(photo: _Photo, height: int, width: int) -> NDArray[np.float32]:
    """Disparity for each pixel of a view, px per view. Raises UserError."""
    near = photo.nearness
    of = photo.picture.shape
    if not 1 / _SAME_SHAPE < (near.shape[1] / near.shape[0]) / (of[1] / of[0]) < _SAME_SHAPE:
        what = (
            f"{photo.paths[-1]}: the depth map has {near.shape[1]}x{near.shape[0]} px, the picture"
            f" {of[1]}x{of[0]}"
        )
        raise UserError(what, "rotate or crop one of them to the shape of the other")
    if near.shape[0] * near.shape[1] > height * width:
        near = np.asarray(
            cv2.resize(near, (width, height), interpolation=cv2.INTER_NEAREST), np.float32
        )
    finite = np.isfinite(near)
    low, high = (
        (float(v) for v in np.percentile(near[finite], (1, 99))) if finite.any() else (0.0, 0.0)
    )
    if not high > low:
        raise UserError(
            f"{photo.paths[-1]}: the depth map has one value",
            "use one in which near and far differ",
        )
    share = np.clip((near - np.float32(low)) / np.float32(high - low), 0, 1)
    if not finite.all():  # a pixel without depth is as near as the nearest one with it
        share = share.ravel()[nearest(finite)]
    share = cv2.resize(share, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray((share - np.float32(0.5)) * np.float32(DISPARITY * width), np.float32)


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    photo = _read(listing)
    # eyes move sideways more than up and down
    rows, cols = parse_grid(scene.grid) or (5, 9)
    require_grid(rows, cols, str(listing.path))
    picture = photo.picture
    notes = [f"{rows}x{cols} views are rendered from one picture and its depth; {photo.why}"]
    if unused := [name for name in listing.pictures() if listing.file(name) not in photo.paths]:
        notes.append(f"not used: {some(unused)}")
    scale = (_MAX_PX / (picture.shape[0] * picture.shape[1])) ** 0.5
    if scale < 1:
        picture = np.asarray(
            cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        )
        notes.append(f"rendered at {picture.shape[1]}x{picture.shape[0]} px, for speed")
    picture = np.ascontiguousarray(picture)
    height, width = picture.shape[:2]
    disparity = _disparity(photo, height, width)

    @lru_cache(maxsize=8)
    def disparity_at(row: int, col: int) -> NDArray[np.float32]:
        return warped_disparity(disparity, row - rows // 2, col - cols // 2)

    return SceneSource(
        layout=NAME,
        path=listing.path,
        files=photo.paths,
        rows=rows,
        cols=cols,
        read=lambda frame, row, col: warped_view(
            picture, disparity, disparity_at(row, col), row - rows // 2, col - cols // 2
        ),
        height_px=height,
        width_px=width,
        max_value=photo.full,
        truth={place: partial(disparity_at, *place) for place in np.ndindex(rows, cols)},
        rendered=True,
        turn=GridTransform(),
        turn_by=f"the views are rendered in order; {photo.why}",
        doubt=photo.doubt,
        notes=tuple(notes),
    )
