"""Untrusted videos as recordings: accepted kinds, memory limits, decoding."""

import os
from pathlib import Path
from typing import BinaryIO

# FFmpeg prints straight to stderr, past Python; a UserError here reports the broken file
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import BrokenFrame
from lfpipe.errors import UserError
from lfpipe.files.decoding import codec_name, is_jpeg, is_video, picture_of
from lfpipe.host.files import proc_fd_path
from lfpipe.host.limits import MemoryLimit
from lfpipe.host.terminal import opencv_logging
from lfpipe.scene.video import FRAME_BYTES_PX, MAX_FRAME_PX, OPENING_BYTES

TRIES = 16  # an undecodable frame looks like the end, unless a later one decodes
REMEDY = "give a video (mp4, mkv, avi, ...), a picture or a folder of pictures"
# Kinds allowed besides those of `is_video`.
# FFmpeg would also follow playlists of other files and addresses.
MORE_KINDS = (
    b"OggS",
    b"FLV\x01",
    b"\x30\x26\xb2\x75",  # ASF
    b"\x00\x00\x01",  # MPEG program stream, raw MPEG and H.264
    b"\x00\x00\x00\x01",  # raw H.264, H.265
    b"\x47\x40",  # MPEG transport stream
    b"\xff\xd8\xff",  # JPEGs end to end
    b"YUV4MPEG2 ",
    b"GIF8",
)


@attrs.frozen(eq=False)
class RecordedFrame:
    """A frame of a recording."""

    stamp_ns: int
    """By the recording's own clock."""
    picture: NDArray[np.uint8]
    """uint8 (height, width, 3) BGR."""
    packet: NDArray[np.uint8] | None = None
    """The JPEG that it was decoded from, uint8 (n,), if it has the recording's size."""


class Video:
    """A video, decoded by FFmpeg. Motion JPEG is only demuxed by it and decoded like a camera's
    JPEGs, and its packets are passed through: at 640x480 1.15 ms a frame, as with FFmpeg's own
    decoder.

    width_px, height_px: frame size in the header. rate_hz: 0 if unknown. jpeg: its frames are
    JPEGs.
    """

    def __init__(self, file: BinaryIO, path: Path) -> None:
        """file: open at its start; closed by this object. Raises UserError if it is not a video, or
        too large to decode.
        """
        self._file = file
        self._path = path
        self._capture = cv2.VideoCapture()
        self._memory = MemoryLimit(OPENING_BYTES)  # a stream may change its size midway
        self.jpeg = False
        try:
            start = file.read(16)
            if not is_video(start) and not start.startswith(MORE_KINDS):
                raise UserError(f"{path}: not a readable video", REMEDY)
            self._start()
            self._read_header()
            if self._capture.get(cv2.CAP_PROP_FOURCC) == cv2.VideoWriter.fourcc(*"MJPG"):
                self.jpeg = True
                try:
                    first = self.read(0)
                except BrokenFrame:
                    first = None
                self.jpeg = first is not None and first.packet is not None  # not a half picture
            if not self.jpeg and self.read(0) is None:
                codec = codec_name(self._capture, self._file)
                raise UserError(
                    f"{path}: not a readable video: no frame can be decoded (codec {codec})", REMEDY
                )
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        """Starts over: reopens the file, because not every stream can seek.

        On failure the capture is not open.
        """
        # One decoder thread: measured on 400x300 to 720x576, two take 20 to 40 % more CPU and are
        # no faster. The path is that of the checked descriptor; OpenCV would crash on names that
        # are not UTF-8.
        with self._memory, opencv_logging():
            self._capture.open(
                proc_fd_path(self._file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1]
            )
            if self.jpeg:
                self._capture.set(cv2.CAP_PROP_FORMAT, -1)
        self._grabbed = False  # whether a frame is ready to be retrieved

    def _read_header(self) -> None:
        """Checks sizes, takes the rate, and limits the memory."""
        of = self._capture.get
        self.width_px = int(of(cv2.CAP_PROP_FRAME_WIDTH))
        self.height_px = int(of(cv2.CAP_PROP_FRAME_HEIGHT))
        if not self._capture.isOpened() or self.width_px < 1 or self.height_px < 1:
            raise UserError(f"{self._path}: not a readable video, or too large to decode", REMEDY)
        if self.width_px * self.height_px > MAX_FRAME_PX:
            size = f"{self.width_px}x{self.height_px}"
            raise UserError(
                f"{self._path}: frames of {size} px; the limit is {MAX_FRAME_PX} px",
                "scale the video down",
            )
        rate_hz = float(of(cv2.CAP_PROP_FPS))
        self.rate_hz = rate_hz if 0.01 <= rate_hz < 1e6 else 0.0
        self._memory = MemoryLimit(
            max(OPENING_BYTES, FRAME_BYTES_PX * self.width_px * self.height_px)
        )

    def read(self, index: int) -> RecordedFrame | None:
        """See `Recording.read`."""
        if index == 0:
            self._start()
        with self._memory:
            return self._next_jpeg(index) if self.jpeg else self._next_frame(index)

    def _next_jpeg(self, index: int) -> RecordedFrame | None:
        packet: NDArray[np.uint8] = np.empty(0, np.uint8)
        while packet.size == 0:  # AVI files have empty ones
            if not self._capture.grab():
                return None
            retrieved, data = self._capture.retrieve()
            packet = np.asarray(data, np.uint8).reshape(-1) if retrieved else packet
        picture = picture_of(packet) if is_jpeg(packet) else None
        if picture is None:
            raise self._broken(index)
        own_size = picture.shape == (self.height_px, self.width_px, 3)
        return RecordedFrame(self._stamp_ns(), picture, packet if own_size else None)

    def _next_frame(self, index: int) -> RecordedFrame | None:
        if not self._grabbed and not self._capture.grab():
            self._grabbed = any(self._capture.grab() for _ in range(TRIES))
            if not self._grabbed:
                return None
            raise self._broken(index)
        self._grabbed = False
        retrieved, picture = self._capture.retrieve()
        if not retrieved:
            raise self._broken(index)
        return RecordedFrame(self._stamp_ns(), np.asarray(picture, np.uint8))

    def _stamp_ns(self) -> int:
        return round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)

    def _broken(self, index: int) -> BrokenFrame:
        return BrokenFrame(
            f"{self._path}: frame {index} cannot be decoded",
            "play it with another program, or export it again",
        )

    def close(self) -> None:
        self._capture.release()
        self._file.close()
