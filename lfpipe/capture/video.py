"""Untrusted videos as recordings: accepted kinds, memory limits, decoding."""

import os
from pathlib import Path
from typing import BinaryIO

# FFmpeg prints straight to stderr, past Python; a UserError here reports the broken file
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import BrokenFrame, Recording
from lfpipe.errors import UserError
from lfpipe.files.decoding import fitted, is_jpeg, is_video, picture_of
from lfpipe.host.files import path_of
from lfpipe.host.limits import MemoryLimit
from lfpipe.host.terminal import opencv_logging
from lfpipe.scene.video import FRAME_BYTES_PX, MAX_FRAME_PX, OPENING_BYTES

TRIES = 16  # an undecodable frame looks like the end, unless a later one decodes
REMEDY = "give a video (mp4, mkv, avi, ...), a picture or a folder of pictures"
# Kinds allowed besides those of `is_video`. FFmpeg would also follow playlists of other files and addresses.
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


class Video(Recording):
    """A `Recording`, decoded by FFmpeg. Motion JPEG is only demuxed by it and decoded like a camera's JPEGs, and its packets are
    passed through: at 640x480 1.15 ms a frame, as with FFmpeg's own decoder.

    width_px, height_px: frame size in the header. rate_hz: 0 if unknown. packet: the last JPEG, if it has that size.
    """

    def __init__(self, file: BinaryIO, path: Path) -> None:
        """file: open at its start; closed by this object. Raises UserError if it is not a video, or too large to decode."""
        self._file, self._path, self._capture = file, path, cv2.VideoCapture()
        self._memory = MemoryLimit(OPENING_BYTES)  # a stream may change its size midway
        self._own_size: NDArray[np.uint8] | None = None
        try:
            self.jpeg = False
            start = file.read(16)
            if not is_video(start) and not start.startswith(MORE_KINDS):
                raise UserError(f"{path}: not a readable video", REMEDY)
            self.rewind()
            self._read_header()
            self.jpeg = self._capture.get(cv2.CAP_PROP_FOURCC) == cv2.VideoWriter.fourcc(*"MJPG") and self._packets_are_whole()
            self.rewind()
            if not self.jpeg:
                with self._memory:
                    self._grabbed = self._capture.grab()
                if not self._grabbed:
                    raise UserError(f"{path}: not a readable video", REMEDY)
        except BaseException:
            self.close()
            raise

    def rewind(self) -> None:
        """Starts over; opens the file anew, because not every stream can seek. On failure the capture is not open."""
        # One decoder thread: measured on 400x300 to 720x576, two take 20 to 40 % more CPU and are no faster. The path is
        # that of the checked descriptor; OpenCV would crash on names that are not UTF-8.
        with self._memory, opencv_logging():
            self._capture.open(path_of(self._file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            if self.jpeg:
                self._capture.set(cv2.CAP_PROP_FORMAT, -1)
        self._grabbed = False  # whether a frame is ready to be retrieved
        self._count = 0  # frames since the start

    def _read_header(self) -> None:
        """Checks sizes, takes the rate, and limits the memory."""
        of = self._capture.get
        self.width_px, self.height_px = int(of(cv2.CAP_PROP_FRAME_WIDTH)), int(of(cv2.CAP_PROP_FRAME_HEIGHT))
        if not self._capture.isOpened() or self.width_px < 1 or self.height_px < 1:
            raise UserError(f"{self._path}: not a readable video, or too large to decode", REMEDY)
        if self.width_px * self.height_px > MAX_FRAME_PX:
            size = f"{self.width_px}x{self.height_px}"
            raise UserError(f"{self._path}: frames of {size} px; the limit is {MAX_FRAME_PX} px", "scale the video down")
        rate_hz = float(of(cv2.CAP_PROP_FPS))
        self.rate_hz = rate_hz if 0.01 <= rate_hz < 1e6 else 0.0
        self._memory = MemoryLimit(max(OPENING_BYTES, FRAME_BYTES_PX * self.width_px * self.height_px))

    def _packets_are_whole(self) -> bool:
        """Whether the first packet is a JPEG of the size in the header, not a half picture."""
        self.jpeg = True
        self.rewind()
        with self._memory:
            _, packet = self._next_packet() or (0, np.empty(0, np.uint8))
            picture = picture_of(packet) if is_jpeg(packet) else None
        return picture is not None and picture.shape == (self.height_px, self.width_px, 3)

    def _next_packet(self) -> tuple[int, NDArray[np.uint8]] | None:
        """Stamp in ns and bytes of the next packet that is not empty (AVI files have empty ones); None at the end."""
        while self._capture.grab():
            stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            self._count += 1
            taken, data = self._capture.retrieve()
            if taken and data.size:
                return stamp_ns, np.asarray(data, np.uint8).reshape(-1)
        return None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """See `Recording.next`."""
        with self._memory:
            return self._next_jpeg(out) if self.jpeg else self._next_frame(out)

    def _next_jpeg(self, out: NDArray[np.uint8]) -> int | None:
        if (following := self._next_packet()) is None:
            return None
        stamp_ns, packet = following
        picture = picture_of(packet) if is_jpeg(packet) else None
        if picture is None:
            raise self._broken("is not a decodable JPEG")
        self.packet = packet if picture.shape == (self.height_px, self.width_px, 3) else None
        fitted(picture, out)
        return stamp_ns

    def _next_frame(self, out: NDArray[np.uint8]) -> int | None:
        self._count += 1
        if not self._grabbed and not self._capture.grab():
            self._grabbed = any(self._capture.grab() for _ in range(TRIES))
            if not self._grabbed:
                return None
            raise self._broken("cannot be decoded")
        self._grabbed = False
        stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        same = out.shape == (self.height_px, self.width_px, 3)
        decoded, frame = self._capture.retrieve(out if same else self._own_size)
        if not decoded:
            raise self._broken("cannot be decoded")
        picture = np.asarray(frame, np.uint8)
        if not same:
            self._own_size = picture
        fitted(picture, out)
        return stamp_ns

    def _broken(self, why: str) -> BrokenFrame:
        return BrokenFrame(f"{self._path}: frame {self._count - 1} {why}", "play it with another program, or export it again")

    def close(self) -> None:
        self._capture.release()
        self._file.close()
