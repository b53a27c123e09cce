"""A video file whose frames are pictures of a scene, decoded completely before use.

A container's claims about its frames may differ from its stream, and only decoding reveals that. In
the packer, a decoder that runs out of memory, crashes or hangs means a refusal.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import is_video
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import proc_fd_path

OPENING_BYTES = 200_000_000  # memory limit of a decoder before the frame size is known
FRAME_BYTES_PX = 20  # memory limit per pixel afterwards; measured: 6 to 15 with FFV1, MPEG-4, VP9
MAX_FRAME_PX = 22_000_000  # 9x9 views of 512x512; OpenCV holds a frame three times
USUAL_RATE_HZ = 25.0  # for a video without a rate
_REMEDY = "play it with another program, or export it again"


class Video:
    """Frames of a video as RGB, by number; seeks only if they are not read in order.

    frames: number of decodable frames.
    """

    def __init__(self, path: Path) -> None:
        """Raises UserError if it is not a video, too large, or has no frames."""
        self._path = path
        self._file = open_file(path)
        if not is_video(self._file.read(12)):
            raise UserError(
                f"{path}: not a readable video (MP4, QuickTime, Matroska, WebM or AVI)", _REMEDY
            )
        self._open(MAX_FRAME_PX)
        self.width_px, self.height_px = (
            int(self._capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        if self.width_px * self.height_px > MAX_FRAME_PX:
            what = (
                f"{path}: a video of {self.width_px}x{self.height_px} px; at most {MAX_FRAME_PX} px"
                " are decoded"
            )
            raise UserError(what, _REMEDY)
        if not self._capture.isOpened() or self.width_px * self.height_px < 1:
            raise UserError(f"{path}: not a readable video", _REMEDY)
        rate_hz = self._capture.get(cv2.CAP_PROP_FPS)
        self.frames = 0
        self.rate_hz = rate_hz if 0.1 <= rate_hz <= 1000 else USUAL_RATE_HZ
        # nine hours at 30 Hz
        while self.frames < 1_000_000 and self._capture.grab():
            self.frames += 1
        if not self.frames:
            raise UserError(f"{path}: no frame of this video can be decoded", "export it again")
        self._open(self.width_px * self.height_px)

    def _open(self, frame_px: int) -> None:
        """Starts from the first frame.

        FFmpeg decodes; large frames on one thread, because each thread holds its own frames.
        """
        threads = [cv2.CAP_PROP_N_THREADS, 2 if frame_px <= 12_000_000 else 1]
        self._capture = cv2.VideoCapture(proc_fd_path(self._file), cv2.CAP_FFMPEG, threads)
        self._next = 0

    def read(self, frame: int) -> NDArray[Any]:
        """uint8 (height, width, 3). Raises UserError."""
        if frame < self._next:
            self._open(self.width_px * self.height_px)
        while self._next < frame and self._capture.grab():
            self._next += 1
        good, picture = self._capture.read()
        self._next += 1
        if not good or picture.shape != (self.height_px, self.width_px, 3):
            raise UserError(f"{self._path}: frame {frame} cannot be read", "export the video again")
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB, dst=picture))
