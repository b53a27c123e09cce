"""Scenes of one file that is no mosaic: a picture, which is a light field of one view, and an animation (GIF, WebP, AVIF) whose
frames are views along a line: a wiggle."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_frames, read_picture
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import files_source
from lfpipe.scene.layouts._tiles import plane_of, reduced, require_picture, single_picture
from lfpipe.scene.optical_flow import returned_flow, textured
from lfpipe.scene.source import Layout, SceneSource, Turn

_GLANCE_PX, _FEWEST_PX = (
    512,
    300,
)  # longer side of the examined copy; px of detail that red and green must share
_ASIDE_PX = 1.5  # between red and green: more than lens errors
_SAME = 2.0  # grey levels between frames of one view: dithering


def _is_anaglyph(picture: NDArray[Any]) -> bool:
    """Whether red is shifted against green and blue like one eye's picture against the other's."""
    if picture.ndim == 2:
        return False
    small = reduced(picture, _GLANCE_PX)
    red, green = (
        np.asarray(cv2.equalizeHist(plane_of(small[..., channel])), np.uint8) for channel in (0, 1)
    )
    if min(red.shape) < 24:
        return False
    aside, confirmed = returned_flow(red, green)
    detail = confirmed & textured(green)
    if np.count_nonzero(detail) < _FEWEST_PX:
        return False
    across, down = np.abs(aside[detail]).T
    return bool(np.percentile(across, 70) > _ASIDE_PX and np.median(down) < _ASIDE_PX / 3)


def _describe_picture(listing: Listing, scene: config.Scene) -> SceneSource:
    path = require_picture(listing)
    if not scene.force and _is_anaglyph(read_picture(path)[0]):
        raise UserError(
            f"{path}: a red/cyan anaglyph: each eye's picture has lost its other colours, so they cannot be shown apart",
            "give the stereo pair that it was made of; --set scene.force=true shows it flat",
        )
    notes = tuple(f"{name} is the same picture" for name in listing.pictures() if name != path.name)
    return files_source(
        "picture",
        listing,
        {(0, 0): path.name},
        (1, 1),
        turn=Turn(),
        turn_by="there is one view",
        notes=notes,
    )


@lru_cache(maxsize=2)
def _animation(listing: Listing) -> Path | None:
    path = single_picture(listing)
    header = open_header(path) if path else None
    return path if header and header.frames > 1 and header.format not in ("JPEG", "TIFF") else None


def _one_way(frames: list[NDArray[Any]]) -> list[NDArray[Any]]:
    """The frames before the sequence reverses; all of them if it does not."""

    def same(a: int, b: int) -> bool:
        return float(cv2.norm(frames[a], frames[b], cv2.NORM_L1)) < _SAME * frames[a].size

    count = len(frames)
    for last, back in ((count // 2, count), (count // 2 - 1, count - 1)):
        pairs = [(k, back - k) for k in range(last) if back - k < count and k < back - k]
        if (
            len(pairs) >= max(1, (count - 1) // 2)
            and count > 2
            and all(same(a, b) for a, b in pairs)
        ):
            return frames[: back // 2 + 1]
    return frames


def _describe_animation(listing: Listing, scene: config.Scene) -> SceneSource:
    path = _animation(listing) or require_picture(listing)
    frames = read_frames(path)
    views = _one_way(frames)
    note = f"{len(views)} of {len(frames)} frames are used: the others go back the same way"
    height, width = views[0].shape[:2]
    return SceneSource(
        certain=False, layout="gif", path=listing.path, files=(path,), rows=1, cols=len(views),
        read=lambda frame, row, col: views[col], height_px=height, width_px=width,
        notes=(note,) if len(views) < len(frames) else (),
    )  # fmt: skip


LAYOUTS = (
    Layout(
        "picture",
        lambda listing: None if single_picture(listing) is None else 10,
        _describe_picture,
    ),
    Layout("gif", lambda listing: None if _animation(listing) is None else 90, _describe_animation),
)
