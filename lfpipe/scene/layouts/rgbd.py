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
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._embedded_depth import embedded_depth, has_depth
from lfpipe.scene.layouts._grid import parse_grid, require_grid, some
from lfpipe.scene.layouts._names import MAPS, read_names
from lfpipe.scene.layouts._tiles import halves, require_picture, single_picture
from lfpipe.scene.missing_views import nearest, warped_disparity, warped_view
from lfpipe.scene.source import GridTransform, SceneSource

NAME = "rgbd"
_NAMED = re.compile(r"rgb-?[dz](?![a-z])")
_DEPTH = re.compile(r"depth|disparity|(?<![a-z])(dpt|disp)(?![a-z])")
_BETWEEN = re.compile(r"[-_. /]+")
_COLOUR = re.compile(r"(?<![a-z])(rgb|colou?r|images?|img|photo|picture)(?![a-z])")
# of a recording, in a folder with its depth or in its own; other names may be views
_FRAME = re.compile(r"(rgb|colou?r)[-_. ]*\d{1,9}|(rgb|colou?r|images?|img|photo|picture)[^/]*/.*")
_INVERSE = re.compile(r"disp|inverse|inv[-_ ]?depth")  # larger is nearer by definition
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


def _stem(name: str) -> str:
    return name.rpartition(".")[0].lower()


def _words(name: str) -> str:
    """A name without its suffix, the words for depth and colour, and zeros before numbers."""
    rest = _BETWEEN.sub("", _COLOUR.sub("", _DEPTH.sub("", _stem(name))))
    return re.sub(r"0+(?=\d)", "", rest)


def _frames(listing: Listing) -> list[str]:
    """The pictures of a recording by a depth camera (rgb_0001, depth_0001; rgb/, depth/)."""
    return [name for name in listing.pictures() if _FRAME.fullmatch(_stem(name))]


def _pair(listing: Listing) -> tuple[str, str] | None:
    """Names of a picture and of its depth map; the first of several pairs."""
    names = listing.pictures()
    depths = [name for name in names if _DEPTH.search(_stem(name))]
    pictures = [name for name in names if name not in depths and not MAPS.search(_stem(name))]
    if len(pictures) == 1 and len(depths) == 1:
        return pictures[0], depths[0]
    named = {_words(name): name for name in reversed(pictures)}
    pairs = [(named[_words(depth)], depth) for depth in depths if _words(depth) in named]
    counted = read_names(tuple(pictures)) if pairs else None
    # views, of which each may have its own depth
    views = counted is not None and not (counted.runs and 2 * len(_frames(listing)) > len(pictures))
    return None if views or not pairs else pairs[0]


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
    are as near as their nearest neighbour.
    """
    share = np.clip((near - np.float32(low)) / np.float32(high - low), 0, 1)
    known = np.isfinite(near)
    if not known.any():
        return np.zeros_like(near)
    if not known.all():
        share = share.ravel()[nearest(known)]
    return np.asarray(share, np.float32)


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
