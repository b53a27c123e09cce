"""An animation (GIF, WebP, AVIF) whose frames are views along a line: a wiggle. If it goes there and back, each view counts
once."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_frames
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._tiles import single_picture
from lfpipe.scene.source import SceneSource

NAME = "gif"
_ANIMATED = (".gif", ".webp", ".avif", ".png")
_SAME = 2.0  # grey levels between frames of one view: dithering


@lru_cache(maxsize=2)
def _path(listing: Listing) -> Path | None:
    path = single_picture(listing)
    try:
        return path if path and path.suffix.lower() in _ANIMATED and open_header(path).frames > 1 else None
    except UserError:
        return None


def detect(listing: Listing) -> int | None:
    return 90 if _path(listing) is not None else None


def _there(frames: list[NDArray[Any]]) -> list[NDArray[Any]]:
    """The frames before the sequence reverses; all of them if it does not."""

    def same(a: int, b: int) -> bool:
        return float(cv2.norm(frames[a], frames[b], cv2.NORM_L1)) < _SAME * frames[a].size

    count = len(frames)
    for last, back in ((count // 2, count), (count // 2 - 1, count - 1)):
        pairs = [(k, back - k) for k in range(last) if back - k < count and k < back - k]
        if len(pairs) >= max(1, (count - 1) // 2) and count > 2 and all(same(a, b) for a, b in pairs):
            return frames[: back // 2 + 1]
    return frames


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = _path(listing)
    if path is None:
        raise UserError(f"{listing.path}: not one animation", "give the GIF itself")
    frames = read_frames(path)
    views = _there(frames)
    notes = (
        (f"{len(views)} of {len(frames)} frames are used: the others go back the same way",) if len(views) < len(frames) else ()
    )
    height, width = views[0].shape[:2]
    return SceneSource(
        certain=False, layout=NAME, path=listing.path, files=(path,), rows=1, cols=len(views),
        read=lambda frame, row, col: views[col], height_px=height, width_px=width, notes=notes,
    )  # fmt: skip
