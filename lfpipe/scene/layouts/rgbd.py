"""A picture with its depth map: side by side or one below the other in one file (Looking Glass
RGB-D), in two files, or inside a JPEG as phones write it.

Views around the picture are rendered from it: shifted by depth, holes filled from behind.
"""

import re
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
from lfpipe.scene.files import Listing, list_scene
from lfpipe.scene.layouts._embedded_depth import embedded_depth, has_depth
from lfpipe.scene.layouts._folders import depth_folders
from lfpipe.scene.layouts._grid import parse_grid, require_grid, some
from lfpipe.scene.layouts._names import MAPS, read_names
from lfpipe.scene.layouts._tiles import (
    glance,
    halves,
    one_picture_twice,
    require_picture,
    single_picture,
)
from lfpipe.scene.missing_views import nearest, warped_disparity, warped_view
from lfpipe.scene.source import GridTransform, SceneSource

NAME = "rgbd"
_NAMED = re.compile(r"rgb-?[dz](?![a-z])")
_DEPTH = re.compile(r"depth|disparity|(?<![a-z])(dpt|disp)(?![a-z])")
_BETWEEN = re.compile(r"[-_. ]+")
_COLOUR = re.compile(r"(?<![a-z])(rgb|colou?r|images?|img|photo|picture)(?![a-z])")
# of a recording: colour and depth with the same number in one folder; other names may be views
_FRAME = re.compile(r"(rgb|colou?r)[-_. ]*\d{1,9}")
_INVERSE = re.compile(r"disp|inverse|inv[-_ ]?depth")  # larger is nearer by definition
_MAX_PX = 700_000  # of the rendered views: 45 of them are packed in ten seconds
_SAME_SHAPE = 1.2  # maximum ratio of the aspects of a picture and its depth map
# levels between channels: the maximum for a depth map, the minimum for a picture
_GREY, COLOURED = 2.0, 6.0
LOWER = 0.35  # significant correlation of height with nearness
DISPARITY = 0.008  # per view, between the nearest and the farthest, as a share of the width
_HOLE_PX = 7  # around holes, where the edge of the front surface may be
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
    """(nearness, why, doubt), as in `_Photo`, of a stored depth map, uint8 or uint16 (h, w).

    16-bit values that do not span the whole range are distances: near is small, 0 means not
    measured. In other maps white is near, unless lower parts, which usually are nearer, are
    darker. by_format: the format defines white as near.
    """
    values = stored.astype(np.float32)
    if by_format or _INVERSE.search(name):
        return values, "white is near", ""
    if stored.dtype == np.uint16 and (int(stored.min()) > 0 or int(stored.max()) < 65535):
        with np.errstate(divide="ignore"):
            near = np.where(stored > 0, 1 / values, np.float32(np.nan)).astype(np.float32)
        against = _lower_is_nearer(near) < -LOWER
        doubt = "whether the depth map contains distances: lower parts would be farther"
        return (
            near,
            "near is small in the depth map, as in distances; 0 was not measured",
            f"{doubt}; {_LEFT_OPEN}" if against else "",
        )
    lower = _lower_is_nearer(values)
    if lower < -LOWER:
        what = f"whether black is near in the depth map: lower parts are darker; {_LEFT_OPEN}"
        return -values, "black is near: lower parts of the depth map are darker", what
    doubt = f"whether white is near in the depth map; {_LEFT_OPEN}"
    return values, "white is near", "" if lower > LOWER else doubt


def _lower_is_nearer(nearness: NDArray[np.float32]) -> float:
    """Correlation of height in the picture with nearness: positive if lower parts are nearer."""
    small = nearness[:: max(1, nearness.shape[0] // 200), :: max(1, nearness.shape[1] // 200)]
    y = np.broadcast_to(np.arange(small.shape[0])[:, None], small.shape)
    use = np.isfinite(small)
    if use.sum() < 100 or float(small[use].std()) < 1e-9:
        return 0.0
    return float(np.corrcoef(y[use], small[use])[0, 1])


def _pair(listing: Listing) -> tuple[str, str] | None:
    """Names of a picture and of its depth map: by name, or by content if the stems are equal; the
    first of several pairs.
    """
    if pair := _recorded(listing):
        return pair
    names = listing.pictures()
    if len(names) == 2 and Path(names[0]).stem.lower() == Path(names[1]).stem.lower():
        return _by_content(listing, names)
    depths = [name for name in names if _DEPTH.search(Path(name).stem.lower())]
    pictures = [name for name in names if name not in depths and not MAPS.search(Path(name).stem)]
    if not depths or not pictures:
        return None
    if len(pictures) == 1 and len(depths) == 1:
        return pictures[0], depths[0]
    named = {_words(name): name for name in reversed(pictures)}
    pairs = [(named[_words(depth)], depth) for depth in depths if _words(depth) in named]
    counted = read_names(tuple(pictures)) is not None  # views, of which each may have its own depth
    if not pairs or (counted and 2 * len(_frames(listing)) < len(pictures)):
        return None
    return pairs[0]


def _frames(listing: Listing) -> list[str]:
    """The pictures of a recording by a depth camera (rgb_0001, depth_0001; rgb/, depth/)."""
    if folders := depth_folders(listing):
        return list_scene(listing.file(folders[0])).pictures()
    return [name for name in listing.pictures() if _FRAME.fullmatch(Path(name).stem.lower())]


def _words(name: str) -> str:
    """A name without its suffix and the words for depth and colour."""
    return _BETWEEN.sub("", _COLOUR.sub("", _DEPTH.sub("", Path(name).stem.lower())))


@lru_cache(maxsize=2)
def _recorded(listing: Listing) -> tuple[str, str] | None:
    """The first picture and its depth map in a depth camera's recording, with a folder each for
    colour and depth: the same name, else the nearest number (times differ slightly).
    """
    folders = depth_folders(listing)
    if folders is None:
        return None
    colour, depth = folders
    pictures, maps = (list_scene(listing.file(name)).pictures() for name in (colour, depth))
    numbered = read_names(tuple(pictures))
    if not pictures or not maps or (numbered is not None and not numbered.runs):
        return None  # a grid of views, each with its depth
    stem, number = Path(pictures[0]).stem, _number(pictures[0])
    nearest_map = min(maps, key=lambda name: (Path(name).stem != stem, abs(_number(name) - number)))
    return f"{colour}/{pictures[0]}", f"{depth}/{nearest_map}"


def _number(name: str) -> float:
    """The last number in a name; 0 if there is none."""
    return float(["0", *re.findall(r"\d{1,20}(?:\.\d{1,9})?", Path(name).stem)][-1])


def _by_content(listing: Listing, names: list[str]) -> tuple[str, str] | None:
    """The picture and its depth map, of two files with one stem: the depth map is grey, and the
    smoother one of two grey ones.
    """
    if one_picture_twice(listing) is not None:
        return None
    looks = {name: glance(listing.file(name)) for name in names}
    colours = {name: colour_levels(look) for name, look in looks.items()}
    grey = [name for name in names if colours[name] < _GREY]
    if not grey or (len(grey) == 1 and max(colours.values()) < COLOURED):
        return None
    depth = min(grey, key=lambda name: float(np.abs(cv2.Laplacian(looks[name], cv2.CV_32F)).mean()))
    return next(name for name in names if name != depth), depth


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
            if colour_levels(depth) < _GREY and colour_levels(image) > COLOURED:
                return image, depth
    return None


def detect(listing: Listing) -> int | None:
    if _pair(listing) is not None:
        return 84
    path = single_picture(listing)
    if path is not None and has_depth(path):
        return 87
    if path is None or not _NAMED.search(path.stem.lower()):
        return None
    return None if _beside(read_picture(path)[0]) is None else 88


def _read(listing: Listing) -> _Photo:
    """Raises UserError."""
    if pair := _pair(listing):
        paths = tuple(listing.file(name) for name in pair)
        (picture, full), (stored, _) = read_picture(paths[0]), read_picture(paths[1])
        if colour_levels(stored) > COLOURED:
            raise UserError(
                f"{paths[1]}: the depth map has false colours",
                "save it in grey, with near parts white",
            )
        near, why, doubt = read_depth(
            stored if stored.ndim == 2 else stored[..., 1], pair[1].lower().rpartition(".")[0]
        )
        if len(_frames(listing)) > 1:
            doubt = "; ".join(filter(None, (_FRAMES, doubt)))
        if (
            paths[0].stem.lower() == paths[1].stem.lower()
            and picture.ndim == 2
            and "/" not in pair[0]
        ):
            doubt = "; ".join(filter(None, (f"whether {pair[1]} is the depth of {pair[0]}", doubt)))
        return _Photo(paths=paths, picture=picture, full=full, nearness=near, why=why, doubt=doubt)
    path = require_picture(listing)
    picture, full = read_picture(path)
    if has_depth(path):
        near = np.asarray(upright(embedded_depth(path), open_header(path).orientation), np.float32)
        return _Photo(
            paths=(path,),
            picture=picture,
            full=full,
            nearness=near,
            why="depth from the photograph's own depth map",
        )
    both = _beside(picture)
    if both is None:
        raise UserError(
            f"{path}: neither half is a grey depth map beside a coloured picture",
            "give picture and depth side by side, or as x.png and x_depth.png in a folder of"
            " their own",
        )
    near, why, doubt = read_depth(both[1][..., 1], path.stem.lower(), by_format=True)
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
    known = np.isfinite(near)
    low, high = (
        (float(v) for v in np.percentile(near[known], (1, 99))) if known.any() else (0.0, 0.0)
    )
    if not high > low:
        raise UserError(
            f"{photo.paths[-1]}: the depth map has one value",
            "use one in which near and far differ",
        )
    share = np.asarray(
        cv2.resize(filled(near, low, high), (width, height), interpolation=cv2.INTER_LINEAR)
    )
    return np.asarray((share - np.float32(0.5)) * np.float32(DISPARITY * width), np.float32)


def filled(near: NDArray[np.float32], low: float, high: float) -> NDArray[np.float32]:
    """Nearness (h, w) as a share of its range from low to high; unmeasured pixels, which are NaN,
    are behind their neighbours.
    """
    share = np.clip((near - np.float32(low)) / np.float32(high - low), 0, 1)
    known = np.isfinite(near)
    if not known.any():
        return np.zeros_like(near)
    if not known.all():
        behind = cv2.erode(
            np.where(known, share, np.float32(1)), np.ones((_HOLE_PX, _HOLE_PX), np.uint8)
        )
        share = np.where(known, share, np.asarray(behind).ravel()[nearest(known)])
    return np.asarray(share, np.float32)


def _unused(listing: Listing, photo: _Photo) -> list[str]:
    """The other pictures of the folder, or of the folders of a recording."""
    if not _recorded(listing):
        return [name for name in listing.pictures() if listing.file(name) not in photo.paths]
    return [
        f"{folder.name}/{name}"
        for folder in dict.fromkeys(path.parent for path in photo.paths)
        for name in list_scene(folder).pictures()
        if folder / name not in photo.paths
    ]


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    photo = _read(listing)
    # eyes move sideways more than up and down
    rows, cols = parse_grid(scene.grid) or (5, 9)
    require_grid(rows, cols, str(listing.path))
    picture = photo.picture
    notes = [f"{rows}x{cols} views are rendered from one picture and its depth; {photo.why}"]
    if unused := _unused(listing, photo):
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

    def read(frame: int, row: int, col: int) -> NDArray[Any]:
        return warped_view(
            picture, disparity, disparity_at(row, col), row - rows // 2, col - cols // 2
        )

    return SceneSource(
        layout=NAME,
        path=listing.path,
        files=photo.paths,
        rows=rows,
        cols=cols,
        read=read,
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
