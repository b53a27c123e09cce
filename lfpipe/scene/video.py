"""A video file whose frames are pictures of a scene, read completely before anything relies on it.

A container's claims about its frames may differ from its stream, and only decoding shows that. In the packer, running out of
memory, a crash or a hang of the decoder is a refusal.
"""

from pathlib import Path
from typing import Any, BinaryIO

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import is_video
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import path_of

OPENING_BYTES = 200_000_000  # memory limit of a decoder before the frame size is known
FRAME_BYTES_PX = 20  # memory limit per pixel afterwards; measured: 6 to 15 with FFV1, MPEG-4, VP9
MAX_FRAME_PX = 22_000_000  # 9x9 views of 512x512; OpenCV holds a frame three times
MAX_FRAMES = 1_000_000
USUAL_RATE_HZ = 25.0  # for a video without a rate
_REMEDY = "play it with another program, or export it again"


@attrs.frozen
class About:
    """Counted content of a video: number of frames that decode, and their size."""

    frames: int
    width_px: int
    height_px: int
    rate_hz: float


def open_video(path: str, frame_px: int) -> cv2.VideoCapture:
    """Opens a video for decoding by FFmpeg; large frames on one thread, because each thread holds its own frames."""
    return cv2.VideoCapture(path, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 2 if frame_px <= 12_000_000 else 1])


def examine(path: Path) -> About:
    """The content of the video at path. Raises UserError if it is not a video, too large, or has no frames."""
    with open_file(path) as file:
        if not is_video(file.read(12)):
            raise UserError(f"{path}: not a readable video (MP4, QuickTime, Matroska, WebM or AVI)", _REMEDY)
        capture = open_video(path_of(file), MAX_FRAME_PX)
        width, height = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MAX_FRAME_PX:
            raise UserError(f"{path}: a video of {width}x{height} px; at most {MAX_FRAME_PX} px are decoded", _REMEDY)
        if not capture.isOpened() or width * height < 1:
            raise UserError(f"{path}: not a readable video", _REMEDY)
        rate, frames = capture.get(cv2.CAP_PROP_FPS), 0
        while frames < MAX_FRAMES and capture.grab():
            frames += 1
    if not frames:
        raise UserError(f"{path}: a video without decodable frames", "export it again")
    return About(frames, width, height, rate if 0.1 <= rate <= 1000 else USUAL_RATE_HZ)


class Video:
    """Frames of an examined video as RGB, by number; seeks only if they are not read in order."""

    def __init__(self, path: Path) -> None:
        """Raises UserError."""
        self.about = examine(path)
        self._path = path
        self._file: BinaryIO = open_file(path)
        self._reopen()

    def _reopen(self) -> None:
        self._capture = open_video(path_of(self._file), self.about.width_px * self.about.height_px)
        self._next = 0

    def read(self, frame: int) -> NDArray[Any]:
        """uint8 (height, width, 3). Raises UserError."""
        if frame < self._next:
            self._reopen()
        while self._next < frame and self._capture.grab():
            self._next += 1
        good, picture = self._capture.read()
        self._next += 1
        if not good or picture.shape != (self.about.height_px, self.about.width_px, 3):
            raise UserError(f"{self._path}: frame {frame} cannot be read", "export the video again")
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB, dst=picture))
