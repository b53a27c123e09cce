"""A GIF whose frames are views along a line: a wiggle. If it goes there and back, each view counts once."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import MAX_DECODING_BYTES
from lfpipe.scene.files import Listing, read_bytes
from lfpipe.scene.source import SceneSource

NAME = "gif"
_MAX_BYTES = 60_000_000  # of the file
_SAME = 2.0  # grey levels between frames of one view: dithering


def _path(listing: Listing) -> Path | None:
    names = [name for name in listing.names if name.lower().endswith(".gif")]
    return listing.file(names[0]) if len(names) == 1 and not listing.pictures() else None


def detect(listing: Listing) -> int | None:
    return 80 if _path(listing) is not None else None


def count_frames(data: bytes) -> int:
    """Number of frames of a GIF (GIF89a specification): image descriptors between its blocks; 0 if it is damaged."""

    def table(flags: int) -> int:
        return 3 << (1 + (flags & 7)) if flags & 0x80 else 0

    frames, at = 0, 13 + table(data[10] if len(data) > 10 else 0)
    while at < len(data) and data[at] in (0x21, 0x2C):
        if data[at] == 0x2C:
            frames += 1
            at += 10 + table(data[at + 9] if at + 9 < len(data) else 0) + 1
        else:
            at += 2
        while at < len(data) and data[at]:
            at += 1 + data[at]
        at += 1
    return frames


def _frames(path: Path) -> list[NDArray[Any]]:
    """All frames, uint8 (h, w, 3) RGB. Raises UserError."""
    data, remedy = read_bytes(path, _MAX_BYTES), f"`ffmpeg -i {path} view_%03d.png` in a new folder, and give that"
    width, height = (int.from_bytes(data[k : k + 2], "little") for k in (6, 8))
    count = count_frames(data) if data[:6] in (b"GIF87a", b"GIF89a") else 0
    if count == 0 or width * height == 0:
        raise UserError(f"{path}: not a readable GIF", "fetch or export it again")
    if 2 * 4 * width * height * count > MAX_DECODING_BYTES:
        raise UserError(f"{path}: {count} frames of {width}x{height} px are too many to decode at once", remedy)
    try:
        good, found = cv2.imdecodemulti(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
    except cv2.error:
        good, found = False, ()
    if not good or len(found) != count:
        raise UserError(f"{path}: a GIF that this OpenCV ({cv2.__version__}) does not decode", remedy)
    return [np.asarray(frame, np.uint8) for frame in found]


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
        raise UserError(f"{listing.path}: not exactly one GIF", "give the GIF itself")
    frames = _frames(path)
    views = _there(frames)
    notes = (
        (f"{len(views)} of {len(frames)} frames are used: the others go back the same way",) if len(views) < len(frames) else ()
    )
    height, width = views[0].shape[:2]
    return SceneSource(
        certain=False, layout=NAME, path=listing.path, files=(path,), rows=1, cols=len(views),
        read=lambda frame, row, col: views[col], height_px=height, width_px=width, notes=notes,
    )  # fmt: skip
