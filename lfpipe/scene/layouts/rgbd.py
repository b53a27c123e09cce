"""A picture with its depth map: side by side or one below the other in one file (Looking Glass RGB-D), in two files, or inside
a JPEG as phones write it.

White is near. Views around the picture are synthesised from it: shifted by depth, holes filled from behind.
"""

import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture, upright
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._embedded_depth import embedded_depth, has_depth
from lfpipe.scene.layouts._grid import parse_grid, require_grid
from lfpipe.scene.layouts._tiles import single_picture
from lfpipe.scene.missing_views import warped_disparity, warped_view
from lfpipe.scene.source import SceneSource, Turn

NAME = "rgbd"
_NAMED = re.compile(r"rgb-?[dz](?![a-z])")
_DEPTH = re.compile(r"depth|disparity|(?<![a-z])dpt")
_GRID = (5, 9)
_SAME_SHAPE = 1.2  # most ratio of the aspects of a picture and its depth map
_LOWER = 0.35  # correlation of height with depth that means something
_RANGE_SHARE = 0.008  # of the width: disparity between the nearest and the farthest, per view
_GREY, _COLOURED = 2.0, 6.0  # levels between channels: at most for a depth map, at least for a picture


def _pair(listing: Listing) -> tuple[str, str] | None:
    """Names of a picture and of its depth: of two pictures in a folder, or of three if its name contains the picture's."""
    stems = {Path(name).stem.lower(): name for name in listing.pictures()} if not listing.is_file else {}
    depths = [stem for stem in stems if _DEPTH.search(stem)]
    if len(depths) != 1 or len(stems) > 3:
        return None
    others = [stem for stem in stems if stem != depths[0]]
    pictures = others if len(others) == 1 else [stem for stem in others if stem in depths[0]]
    return (stems[pictures[0]], stems[depths[0]]) if len(pictures) == 1 else None


def _colour(part: NDArray[Any]) -> float:
    """Difference between the channels of a picture, in levels."""
    if part.ndim == 2:
        return 0.0
    small = cv2.resize(part, (64, 64), interpolation=cv2.INTER_AREA).astype(np.float32)
    return float(np.percentile(np.ptp(small, axis=2), 90))


def _beside(picture: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]] | None:
    """(picture, depth) of a file that holds both: the grey half is the depth; None if there is none."""
    if picture.ndim == 2:
        return None
    height, width = picture.shape[0] // 2, picture.shape[1] // 2
    splits = [(picture[:, :width], picture[:, width : 2 * width]), (picture[:height], picture[height : 2 * height])]
    for first, second in splits:
        for image, depth in ((first, second), (second, first)):
            if _colour(depth) < _GREY and _colour(image) > _COLOURED:
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
    try:
        return 88 if _beside(read_picture(path)[0]) is not None else None
    except UserError:
        return None


def _read(listing: Listing) -> tuple[tuple[Path, ...], NDArray[Any], NDArray[Any], int]:
    """(files, picture, depth, full value of the picture). Raises UserError."""
    pair = _pair(listing)
    if pair is not None:
        paths = tuple(listing.file(name) for name in pair)
        (picture, full), (depth, _) = read_picture(paths[0]), read_picture(paths[1])
        return paths, picture, depth, full
    path = single_picture(listing)
    if path is None:
        raise UserError(f"{listing.path}: no picture with a depth map", "name them x.png and x_depth.png, alone in a folder")
    picture, full = read_picture(path)
    if has_depth(path):
        return (path,), picture, upright(255 * embedded_depth(path), open_header(path).orientation), full
    found = _beside(picture)
    if found is None:
        raise UserError(
            f"{path}: neither half is a grey depth map beside a coloured picture",
            "give picture and depth side by side, or as x.png and x_depth.png in a folder of their own",
        )
    return (path,), *found, full


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    paths, picture, depth, full = _read(listing)
    height, width = picture.shape[:2]
    rows, cols = parse_grid(scene.grid) or _GRID
    require_grid(rows, cols, str(listing.path))
    plane = np.asarray(depth if depth.ndim == 2 else depth[..., 1], np.float32)
    if not 1 / _SAME_SHAPE < (plane.shape[1] / plane.shape[0]) / (width / height) < _SAME_SHAPE:
        what = f"{paths[-1]}: a depth map of {plane.shape[1]}x{plane.shape[0]} px for a picture of {width}x{height}"
        raise UserError(what, "turn or crop one of them to the shape of the other")
    plane = np.asarray(cv2.resize(plane, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
    if _colour(depth) > _COLOURED:
        raise UserError(f"{paths[-1]}: a depth map in false colours", "save it in grey, with near things white")
    low, high = (float(v) for v in np.percentile(plane, (1, 99)))
    if high - low < 1:
        raise UserError(f"{paths[-1]}: a depth map of one value", "use one in which near is white and far is black")
    below = np.broadcast_to(np.arange(plane.shape[0])[:, None], plane.shape)
    lower_is_darker = float(np.corrcoef(below.ravel(), plane.ravel())[0, 1]) < -_LOWER
    doubt = "whether white is near: what stands lower is darker; press d in the window, or set scene.half_turn=yes"
    disparity = np.asarray((np.clip((plane - low) / (high - low), 0, 1) - 0.5) * (_RANGE_SHARE * width), np.float32)

    @lru_cache(maxsize=8)
    def made(row: int, col: int) -> NDArray[np.float32]:
        return warped_disparity(disparity, row - rows // 2, col - cols // 2)

    def read(frame: int, row: int, col: int) -> NDArray[Any]:
        return warped_view(picture, disparity, made(row, col), row - rows // 2, col - cols // 2)

    truth = {(row, col): (lambda r=row, c=col: made(r, c)) for row in range(rows) for col in range(cols)}
    return SceneSource(
        layout=NAME, path=listing.path, files=paths, rows=rows, cols=cols, read=read, height_px=height, width_px=width,
        max_value=full, truth=truth, turn=Turn(), turn_by="the views are made in order, white of the depth map is near",
        doubt=doubt if lower_is_darker else "",
        notes=(f"{rows}x{cols} views are made from one picture and its depth; white is near",),
    )  # fmt: skip
