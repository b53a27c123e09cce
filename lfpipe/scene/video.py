"""A video file whose frames are pictures of a scene; a child process examines it before this one decodes it."""

import subprocess
import sys
from pathlib import Path
from typing import Any, BinaryIO

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import is_video
from lfpipe.files.untrusted import json_fields
from lfpipe.host.descriptors import inherited
from lfpipe.host.pipes import PipeReader
from lfpipe.scene.files import descriptor_path, open_file
from lfpipe.scene.video_probe import MAX_FRAME_PX, open_video

# -P: imports no module from the working directory, which may be anybody's
PROBE = ("-P", "-m", "lfpipe.scene.video_probe")
USUAL_RATE_HZ = 25.0  # for a video without a rate
SILENT_S = 30.0  # without a frame before the video is refused
_REMEDY = "play it with another program, or export it again"


@attrs.frozen
class About:
    """Counted content of a video: number of frames that decode, and their size."""

    frames: int
    width_px: int
    height_px: int
    rate_hz: float


def examine(path: Path) -> About:
    """The content of the video at path. Raises UserError if it is not a video, too large, or hangs or crashes its decoder."""
    with open_file(path) as file:
        if not is_video(file.read(12)):
            raise UserError(f"{path}: not a readable video (MP4, QuickTime, Matroska, WebM or AVI)", _REMEDY)
        name, options = inherited(file)
        command = [sys.executable, *PROBE, name]
        quiet: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(command, stdout=subprocess.PIPE, **quiet, **options) as child:
            try:
                head, dots, end = _answer(path, child)
            finally:
                child.kill()
    fields = json_fields(head or b"{}", str(path), _REMEDY)
    width, height = (fields.integer(key, 0, 1 << 31) if head else 0 for key in ("width_px", "height_px"))
    if width * height > MAX_FRAME_PX:
        raise UserError(f"{path}: a video of {width}x{height} px; at most {MAX_FRAME_PX} px are decoded", _REMEDY)
    if not width * height:
        raise UserError(f"{path}: not a readable video", _REMEDY)
    if not end:
        raise UserError(f"{path}: its decoder stopped or crashed after {dots} frames", _REMEDY)
    if not dots:
        raise UserError(f"{path}: a video without decodable frames", "export it again")
    rate = float(fields.values.get("rate_hz") or 0.0)
    return About(dots, width, height, rate if 0.1 <= rate <= 1000 else USUAL_RATE_HZ)


def _answer(path: Path, child: subprocess.Popen[bytes]) -> tuple[bytes, int, bool]:
    """Output of video_probe: its first line, the number of dots, whether it reached the end."""
    assert child.stdout is not None
    head, tail, dots = b"", b"", 0
    output = PipeReader(child.stdout)
    while True:
        if not output.wait(SILENT_S):
            raise UserError(f"{path}: no frame in {SILENT_S:g} s after {dots} frames", _REMEDY)
        part = output.read()
        if not part:
            return head, dots, tail == b"\nend\n"
        if not head.endswith(b"\n"):
            start, line, part = part.partition(b"\n")
            head += start + line
        dots += part.count(b".")
        tail = (tail + part)[-5:]


class Video:
    """Frames of an examined video as RGB, by number; seeks only if they are not read in order."""

    def __init__(self, path: Path) -> None:
        """Raises UserError."""
        self.about = examine(path)
        self._path = path
        self._file: BinaryIO = open_file(path)
        self._reopen()

    def _reopen(self) -> None:
        self._capture = open_video(descriptor_path(self._file), self.about.width_px * self.about.height_px)
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
