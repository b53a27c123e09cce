"""The kinds of recording that a file source plays: a video, and pictures in the order of their names."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

# FFmpeg prints straight to stderr, past Python; what it says of a broken file is said here as a UserError.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.motion_jpeg import MotionJpeg
from lfpipe.errors import UserError
from lfpipe.files.decoding import fitted, is_jpeg, opencv_name, picture_of
from lfpipe.host import opencv_log

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"})


class Recording(Protocol):
    """Frames one after the other, as often as wanted. rate_hz is 0 where the recording has none of its own. packet: the JPEG
    of the last frame, uint8 (n,), None where it was none of this size.
    """

    width_px: int
    height_px: int
    rate_hz: float
    packet: NDArray[np.uint8] | None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """Decodes the next frame into out (height, width, 3) BGR, scaled where needed; its stamp in ns, or None at the end."""
        ...

    def rewind(self) -> None: ...

    def close(self) -> None: ...


@contextmanager
def quiet_cv2() -> Iterator[None]:
    """OpenCV's warnings about files it cannot read are dropped: the error that follows says it in the user's words."""
    before = opencv_log.set_log_level(opencv_log.SILENT)
    try:
        yield
    finally:
        opencv_log.set_log_level(before)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sorts `frame2` before `frame10`."""
    parts = re.split(r"([0-9]+)", name.lower())  # every second one is a number
    return [(1, int(part), "") if index % 2 else (0, 0, part) for index, part in enumerate(parts)]


class Video:
    """A video through OpenCV's FFmpeg."""

    packet: NDArray[np.uint8] | None = None

    def __init__(self, path: Path) -> None:
        """Raises UserError where path is no video that can be decoded."""
        self._path = path
        # One decoder thread: measured on 400x300 to 720x576, two take 20 to 40 % more CPU and are no faster.
        with quiet_cv2():
            self._capture = cv2.VideoCapture(opencv_name(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            readable = self._capture.isOpened() and self._capture.grab()
        if not readable:
            remedy = "give a video (mp4, mkv, avi, ...), a picture or a folder of pictures"
            raise UserError(f"{path}: no video that can be read", remedy)
        self.width_px = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height_px = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        rate_hz = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.rate_hz = rate_hz if 0.01 <= rate_hz < 1e6 else 0.0
        self._grabbed = True
        self._scratch: NDArray[np.uint8] | None = None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        if not self._grabbed and not self._capture.grab():
            return None
        self._grabbed = False
        stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        same = out.shape == (self.height_px, self.width_px, 3)
        ok, frame = self._capture.retrieve(out if same else self._scratch)
        if not ok:
            return None
        decoded = np.asarray(frame, np.uint8)
        if not same:
            self._scratch = decoded
        fitted(decoded, out)
        return stamp_ns

    def rewind(self) -> None:
        self._capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        if not self._capture.grab():  # a stream that cannot seek is opened anew
            self._capture.open(str(self._path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            self._capture.grab()
        self._grabbed = True

    def close(self) -> None:
        self._capture.release()


def _load(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The bytes of a file, uint8 (n,), and the picture they hold."""
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise UserError(f"{path}: not a picture that can be read: {error.strerror}", "write it anew") from None
    with quiet_cv2():
        picture = picture_of(data)
    if picture is None:
        raise UserError(f"{path}: not a picture that can be read", "take it out of the folder, or write it anew")
    return data, picture


class Pictures:
    """Pictures in natural order of their names."""

    rate_hz = 0.0

    def __init__(self, paths: list[Path]) -> None:
        """Raises UserError where the first of them cannot be decoded."""
        self._paths = paths
        self._index = 0
        data, first = _load(paths[0])
        self.height_px, self.width_px = first.shape[:2]
        self.packet: NDArray[np.uint8] | None = data if is_jpeg(data) else None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        if self._index == len(self._paths):
            return None
        data, picture = _load(self._paths[self._index])
        own_size = picture.shape[:2] == (self.height_px, self.width_px)
        self.packet = data if own_size and is_jpeg(data) else None
        fitted(picture, out)
        self._index += 1
        return 0

    def rewind(self) -> None:
        self._index = 0

    def close(self) -> None:
        pass


def _video(path: Path) -> Recording:
    with quiet_cv2():
        try:
            return MotionJpeg(cv2.VideoCapture(opencv_name(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1]), path)
        except ValueError:
            return Video(path)


def open_recording(path: Path) -> Recording:
    """The recording at path: a video, a picture, or a folder of pictures.

    Raises UserError where there is nothing, nothing readable, or a folder without pictures.
    """
    try:
        names = [entry.name for entry in path.iterdir()] if path.is_dir() else None
        if names is None:
            with path.open("rb"):
                pass
    except FileNotFoundError:
        raise UserError(f"{path}: no such file", "check the path; it is taken from the current directory") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}", "check its permissions") from None
    if names is None:
        return Pictures([path]) if path.suffix.lower() in SUFFIXES else _video(path)
    pictures = [name for name in names if Path(name).suffix.lower() in SUFFIXES and not name.startswith(".")]
    if not pictures:
        kinds = ", ".join(sorted(SUFFIXES))
        raise UserError(f"{path}: a folder without pictures", f"it needs {kinds} files, or name a video in it")
    return Pictures([path / name for name in sorted(pictures, key=natural_key)])
