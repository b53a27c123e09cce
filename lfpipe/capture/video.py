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

DAMAGED = "play it with another program, or export it again"
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
        self._count = 0  # frames since the start
        self._own_size: NDArray[np.uint8] | None = None
        try:
            start = file.read(16)
            if not is_video(start) and not start.startswith(MORE_KINDS):
                raise UserError(f"{path}: not a readable video", REMEDY)
            self._open(jpegs=False)
            self._read_header(start)
            self.jpeg = self._capture.get(cv2.CAP_PROP_FOURCC) == cv2.VideoWriter.fourcc(*"MJPG") and self._packets_are_whole()
            if not self.jpeg:
                self._open(jpegs=False)
                with self._memory:
                    self._grabbed = self._capture.grab()
                if not self._grabbed:
                    raise UserError(f"{path}: not a readable video", REMEDY)
        except BaseException:
            self.close()
            raise
        self._count = 0

    def _open(self, jpegs: bool) -> None:
        """Opens the file at its start; on failure the capture is not open."""
        # One decoder thread: measured on 400x300 to 720x576, two take 20 to 40 % more CPU and are no faster. The path is
        # that of the checked descriptor; OpenCV would crash on names that are not UTF-8.
        with self._memory, opencv_logging():
            self._capture.open(path_of(self._file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            if jpegs:
                self._capture.set(cv2.CAP_PROP_FORMAT, -1)
        self._grabbed = False  # whether a frame is ready to be retrieved

    def _read_header(self, start: bytes) -> None:
        """Checks sizes, takes rate and number of frames (exact in AVI files, else 0), and limits the memory."""
        of = self._capture.get
        self.width_px, self.height_px = int(of(cv2.CAP_PROP_FRAME_WIDTH)), int(of(cv2.CAP_PROP_FRAME_HEIGHT))
        if not self._capture.isOpened() or self.width_px < 1 or self.height_px < 1:
            raise UserError(f"{self._path}: not a readable video, or too large to decode", REMEDY)
        if self.width_px * self.height_px > MAX_FRAME_PX:
            size = f"{self.width_px}x{self.height_px}"
            raise UserError(f"{self._path}: frames of {size} px; the limit is {MAX_FRAME_PX} px", "scale the video down")
        rate_hz, frames = float(of(cv2.CAP_PROP_FPS)), float(of(cv2.CAP_PROP_FRAME_COUNT))
        self.rate_hz = rate_hz if 0.01 <= rate_hz < 1e6 else 0.0
        self._frames = int(frames) if start[8:12] == b"AVI " and 0 < frames < 1e9 else 0
        self._memory = MemoryLimit(max(OPENING_BYTES, FRAME_BYTES_PX * self.width_px * self.height_px))

    def _packets_are_whole(self) -> bool:
        """Whether the first packet is a JPEG of the size in the header, not a half picture. Then the next frame is the first."""
        self._open(jpegs=True)
        with self._memory:
            _, packet = self._next_packet() or (0, None)
            picture = picture_of(packet) if packet is not None and is_jpeg(packet) else None
        if picture is None or picture.shape != (self.height_px, self.width_px, 3):
            return False
        self._open(jpegs=True)
        return True

    def _next_packet(self) -> tuple[int, NDArray[np.uint8]] | None:
        """Stamp in ns and bytes of the next packet that is not empty (AVI files have empty ones); None at the end."""
        while self._capture.grab():
            stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            taken, data = self._capture.retrieve()
            packet = np.asarray(data, np.uint8).reshape(-1) if taken else np.empty(0, np.uint8)
            if packet.size:
                return stamp_ns, packet
            self._count += 1
        return None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """See `Recording.next`."""
        with self._memory:
            stamp_ns = self._next_jpeg(out) if self.jpeg else self._next_frame(out)
        if stamp_ns is None:
            count, self._count = self._count, self._frames  # reported once per loop
            if count < self._frames:  # FFmpeg skips damaged frames
                missing = f"{self._frames - count} of its {self._frames} frames cannot be decoded"
                raise BrokenFrame(f"{self._path}: {missing}", DAMAGED)
        return stamp_ns

    def _next_jpeg(self, out: NDArray[np.uint8]) -> int | None:
        if (following := self._next_packet()) is None:
            return None
        stamp_ns, packet = following
        self._count += 1
        picture = picture_of(packet) if is_jpeg(packet) else None
        if picture is None:
            raise BrokenFrame(f"{self._path}: frame {self._count - 1} is not a decodable JPEG", DAMAGED)
        self.packet = packet if picture.shape == (self.height_px, self.width_px, 3) else None
        fitted(picture, out)
        return stamp_ns

    def _next_frame(self, out: NDArray[np.uint8]) -> int | None:
        if not self._grabbed and not self._capture.grab():
            self._grabbed = any(self._capture.grab() for _ in range(TRIES))
            if not self._grabbed:
                return None
            self._count += 1
            raise BrokenFrame(f"{self._path}: frame {self._count - 1} cannot be decoded", DAMAGED)
        self._grabbed = False
        self._count += 1
        stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        same = out.shape == (self.height_px, self.width_px, 3)
        decoded, frame = self._capture.retrieve(out if same else self._own_size)
        if not decoded:
            raise BrokenFrame(f"{self._path}: frame {self._count - 1} cannot be decoded", DAMAGED)
        picture = np.asarray(frame, np.uint8)
        if not same:
            self._own_size = picture
        fitted(picture, out)
        return stamp_ns

    def rewind(self) -> None:
        """Starts over; opens the file anew, because not every stream can seek."""
        self._open(self.jpeg)
        self._count = 0

    def close(self) -> None:
        self._capture.release()
        self._file.close()
