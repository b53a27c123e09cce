"""A single picture: a light field of one view."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import read_picture
from lfpipe.scene.files import PICTURES, Listing
from lfpipe.scene.layouts._grid import files_source
from lfpipe.scene.layouts._tiles import single_picture
from lfpipe.scene.optical_flow import confirmed, flow, textured
from lfpipe.scene.source import SceneSource, Turn

NAME = "picture"
_GLANCE_PX, _FEWEST_PX = 512, 300
_ASIDE_PX = 1.5  # between red and green: more than lens errors


def is_anaglyph(picture: NDArray[Any]) -> bool:
    """Whether red is shifted against green and blue like one eye's picture against the other's."""
    if picture.ndim == 2:
        return False
    scale = min(1.0, _GLANCE_PX / max(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = small if small.dtype == np.uint8 else cv2.convertScaleAbs(small, alpha=1 / 256)
    red, green = (np.asarray(cv2.equalizeHist(np.ascontiguousarray(small[..., k])), np.uint8) for k in (0, 1))
    if min(red.shape) < 24:
        return False
    there, back = flow(red, green), flow(green, red)
    detail = confirmed(there, back) & textured(green)
    if np.count_nonzero(detail) < _FEWEST_PX:
        return False
    aside, beside = np.abs(there[detail]).T
    return bool(np.percentile(aside, 70) > _ASIDE_PX and np.median(beside) < _ASIDE_PX / 3)


def detect(listing: Listing) -> int | None:
    return 10 if single_picture(listing) is not None else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = single_picture(listing)
    if path is None:
        count = len(listing.pictures())
        raise UserError(f"{listing.path}: contains {count} pictures, not one", f"give one file ({', '.join(PICTURES)})")
    picture, _ = read_picture(path)
    if not scene.force and is_anaglyph(picture):
        raise UserError(
            f"{path}: a red/cyan anaglyph: each eye's picture has lost its other colours, so they cannot be shown apart",
            "give the stereo pair that it was made of; --set scene.force=true shows it flat",
        )
    others = [name for name in listing.pictures() if name != path.name]
    notes = tuple(f"{name} is the same picture" for name in others)
    return files_source(NAME, listing, {(0, 0): path}, 1, 1, turn=Turn(), turn_by="there is one view", notes=notes)
