"""Recordings for a file source: a video, or pictures in order of name."""

import re
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import BrokenFrame
from lfpipe.capture.video import Video
from lfpipe.errors import UserError
from lfpipe.files.decoding import fitted, is_jpeg, picture_of
from lfpipe.files.safe_files import open_regular, reason
from lfpipe.host.files import is_dir
from lfpipe.host.terminal import opencv_logging

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"})
MAX_FILE_BYTES = 1 << 28  # of one picture; larger files are refused


class Recording(Protocol):
    """A rewindable series of frames. rate_hz: 0 if the recording has none. packet: the JPEG of the last frame, uint8 (n,); None
    if it was not a JPEG of this size.
    """

    width_px: int
    height_px: int
    rate_hz: float
    packet: NDArray[np.uint8] | None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """Decodes the next frame into out (height, width, 3) BGR, scaled to fit; returns its stamp in ns, None at the end.

        Raises BrokenFrame if it cannot be decoded; the next call continues after it.
        """
        ...

    def rewind(self) -> None: ...

    def close(self) -> None: ...


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sorts `frame2` before `frame10`."""
    parts = re.split(r"([0-9]+)", name.lower())  # odd parts are numbers
    return [(1, int(part), "") if index % 2 else (0, 0, part) for index, part in enumerate(parts)]


def _load(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The bytes of a file, uint8 (n,), and its picture. Raises BrokenFrame."""
    try:
        with open_regular(path) as file:
            data = np.fromfile(file, np.uint8, MAX_FILE_BYTES)
    except OSError as error:
        raise BrokenFrame(f"{path}: not a readable picture: {reason(error)}", "save it again") from None
    with opencv_logging():
        picture = picture_of(data)
    if picture is None:
        raise BrokenFrame(f"{path}: not a readable picture", "remove it from the folder, or save it again")
    return data, picture


class Pictures:
    """Pictures in natural order of name."""

    rate_hz = 0.0

    def __init__(self, paths: list[Path]) -> None:
        """Raises BrokenFrame if the first cannot be decoded."""
        self._paths = paths
        self._index = 0
        data, first = _load(paths[0])
        self.height_px, self.width_px = first.shape[:2]
        self.packet: NDArray[np.uint8] | None = data if is_jpeg(data) else None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """See `Recording.next`."""
        if self._index == len(self._paths):
            return None
        self._index += 1
        data, picture = _load(self._paths[self._index - 1])
        own_size = picture.shape[:2] == (self.height_px, self.width_px)
        self.packet = data if own_size and is_jpeg(data) else None
        fitted(picture, out)
        return 0

    def rewind(self) -> None:
        self._index = 0

    def close(self) -> None:
        pass


def open_recording(path: Path) -> Recording:
    """Opens the video, picture or folder of pictures at path.

    Raises UserError if it is missing, unreadable, or a folder without pictures.
    """
    try:
        if not is_dir(path):
            file = open_regular(path)
            if path.suffix.lower() not in SUFFIXES:
                return Video(file, path)
            file.close()
            return Pictures([path])
        names = [entry.name for entry in path.iterdir()]
    except FileNotFoundError:
        raise UserError(f"{path}: no such file", "check the path; it is relative to the current directory") from None
    except (OSError, ValueError) as error:
        remedy = "give a video, a picture or a folder of pictures, and check its permissions"
        raise UserError(f"{path}: cannot be read: {reason(error)}", remedy) from None
    pictures = [name for name in names if Path(name).suffix.lower() in SUFFIXES and not name.startswith(".")]
    if not pictures:
        kinds = ", ".join(sorted(SUFFIXES))
        raise UserError(f"{path}: a folder without pictures", f"it needs {kinds} files, or name a video in it")
    return Pictures([path / name for name in sorted(pictures, key=natural_key)])
