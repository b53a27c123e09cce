"""A video file whose frames are pictures of a scene, decoded completely before use.

A container's claims about its frames may differ from its stream, and only decoding reveals that. In
the packer, a decoder that runs out of memory, crashes or hangs means a refusal.
"""

import contextlib
import re
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import ENDS_BYTES, codec_name, is_video
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import proc_fd_path
from lfpipe.host.machine import install_command

OPENING_BYTES = 200_000_000  # memory limit of a decoder before the frame size is known
FRAME_BYTES_PX = 20  # memory limit per pixel afterwards; measured: 6 to 15 with FFV1, MPEG-4, VP9
MAX_FRAME_PX = 22_000_000  # 9x9 views of 512x512; OpenCV holds a frame three times
USUAL_RATE_HZ = 25.0  # for a video without a rate
_LOOKS = 9  # frames of a video that are compared to find one that shows something
# what declares a video stream: in Matroska before its first cluster, in AVI, MP4 and QuickTime
_MATROSKA, _CLUSTER = re.compile(rb"\x83\x81\x01"), b"\x1f\x43\xb6\x75"
_DECLARED = re.compile(rb"strh.{4}vids|hdlr.{8}vide", re.DOTALL)
_REMEDY = "play it with another program, or export it again"


class _Stream:
    """A video stream by PyAV, which decodes more codecs and each of several streams, with the
    methods of cv2.VideoCapture that are used.
    """

    def __init__(self, file: BinaryIO, stream: int) -> None:
        import av

        file.seek(0)
        container = av.open(file, "r")
        self._stream = container.streams.video[stream]
        self._frames = container.decode(self._stream)

    def get(self, what: int) -> float:
        return {
            cv2.CAP_PROP_FRAME_WIDTH: float(self._stream.width),
            cv2.CAP_PROP_FRAME_HEIGHT: float(self._stream.height),
            cv2.CAP_PROP_FOURCC: 0.0,
        }.get(what, float(self._stream.average_rate or 0))

    def isOpened(self) -> bool:
        return True

    def grab(self) -> bool:
        return self._next() is not None

    def read(self) -> tuple[bool, NDArray[Any]]:
        frame = self._next()
        return frame is not None, np.zeros(0) if frame is None else frame.to_ndarray(format="bgr24")

    def _next(self) -> Any:
        from av.error import FFmpegError

        try:
            return next(self._frames, None)
        except FFmpegError:  # the end of what can be decoded
            return None


class Video:
    """Frames of a video as RGB, by number; seeks only if they are not read in order.

    frames: number of decodable frames.
    """

    def __init__(self, path: Path, stream: int = 0) -> None:
        """stream: which of several video streams; the second one needs PyAV. Raises UserError if it
        is not a video, too large, or has no frames.
        """
        self._path = path
        self._stream = stream
        self._file = open_file(path)
        if not is_video(self._file.read(12)):
            raise UserError(
                f"{path}: not a readable video (MP4, QuickTime, Matroska, WebM or AVI)", _REMEDY
            )
        self._by_av = stream > 0
        self.frames = 0
        self._open(MAX_FRAME_PX)
        self._measure()
        codec = "" if self.frames else codec_name(self._capture, self._file)
        if not self.frames and find_spec("av"):
            with contextlib.suppress(Exception):  # PyAV raises many kinds for damage
                self._by_av = True
                self._open(MAX_FRAME_PX)
                self._measure()
        if not self.frames:
            more = "" if find_spec("av") else f"; or {install_command('av')}, which decodes AV1"
            raise UserError(
                f"{path}: not a readable video: no frame can be decoded (codec {codec})",
                f"export it again as H.264{more}",
            )
        self._open(self.width_px * self.height_px)

    def _measure(self) -> None:
        """Size, rate and number of frames; none if it cannot be opened. Raises UserError."""
        self.width_px, self.height_px = (
            int(self._capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        if self.width_px * self.height_px > MAX_FRAME_PX:
            what = (
                f"{self._path}: a video of {self.width_px}x{self.height_px} px; at most"
                f" {MAX_FRAME_PX} px are decoded"
            )
            raise UserError(what, _REMEDY)
        if not self._capture.isOpened() or self.width_px * self.height_px < 1:
            return
        rate_hz = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate_hz = rate_hz if 0.1 <= rate_hz <= 1000 else USUAL_RATE_HZ
        # nine hours at 30 Hz
        while self.frames < 1_000_000 and self._capture.grab():
            self.frames += 1

    def _open(self, frame_px: int) -> None:
        """Starts from the first frame.

        FFmpeg decodes; large frames on one thread, because each thread holds its own frames.
        """
        self._next = 0
        if self._by_av:
            try:
                self._capture: cv2.VideoCapture | _Stream = _Stream(self._file, self._stream)
            except Exception:  # PyAV raises many kinds for damage
                what = f"{self._path}: its video stream {self._stream + 1} cannot be read"
                raise UserError(what, _REMEDY) from None
            return
        threads = [cv2.CAP_PROP_N_THREADS, 2 if frame_px <= 12_000_000 else 1]
        self._capture = cv2.VideoCapture(proc_fd_path(self._file), cv2.CAP_FFMPEG, threads)

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


@lru_cache(maxsize=4)
def telling_frame(path: Path, stream: int = 0) -> tuple[int, NDArray[Any]]:
    """(number, picture) of the first frame with much detail, of a few: frames that fade in from
    black decide nothing. Raises UserError.
    """
    video = Video(path, stream)
    numbers = sorted({round(at) for at in np.linspace(0, video.frames - 1, _LOOKS)})
    pictures = [video.read(number) for number in numbers]
    details = [float(cv2.Laplacian(picture[..., 1], cv2.CV_32F).std()) for picture in pictures]
    first = next(k for k, detail in enumerate(details) if detail >= max(details) / 2)
    return numbers[first], pictures[first]


@lru_cache(maxsize=4)
def stream_count(path: Path) -> int:
    """The number of a file's video streams. Raises UserError."""
    with open_file(path) as file:
        start = file.read(ENDS_BYTES)
        file.seek(max(0, path.stat().st_size - ENDS_BYTES))
        if start.startswith(b"\x1aE"):
            return len(_MATROSKA.findall(start.partition(_CLUSTER)[0]))
        return len(_DECLARED.findall(start) or _DECLARED.findall(file.read()))


def second_stream(path: Path) -> list[str]:
    """What is said of a second stream that is not used; [] if there is none."""
    if stream_count(path) < 2:
        return []
    why = f"reading it needs another package: {install_command('av')}"
    if find_spec("av"):
        why = "it is not the other picture of a stereo pair"
    return [f"the second video stream of {path.name} is not used: {why}"]
