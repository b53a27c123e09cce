"""Untrusted videos, decoded by OpenCV's FFmpeg: accepted kinds, memory limits, opening."""

import os
from pathlib import Path
from typing import BinaryIO

# FFmpeg prints straight to stderr, past Python; a UserError here reports the broken file
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import BrokenFrame
from lfpipe.errors import UserError
from lfpipe.files.decoding import fitted, is_jpeg, is_video, picture_of
from lfpipe.host import quiet
from lfpipe.host.descriptors import path_of
from lfpipe.host.limits import MemoryLimit
from lfpipe.scene.video_probe import FRAME_BYTES_PX, MAX_FRAME_PX, OPENING_BYTES

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


class VideoFile:
    """An open video. width_px, height_px: frame size in the header; rate_hz: 0 if unknown; frames: exact count in the header,
    0 if unknown.

    memory: limit for decoding a frame; a stream may change its size midway.
    """

    def __init__(self, file: BinaryIO, path: Path) -> None:
        """file: open at its start; closed by this object. Raises UserError if it is not a video or too large to decode."""
        self._file, self.path = file, path
        start = file.read(16)
        self.memory = MemoryLimit(OPENING_BYTES)
        self.capture = cv2.VideoCapture()
        try:
            if not is_video(start) and not start.startswith(MORE_KINDS):
                raise UserError(f"{path}: not a readable video", REMEDY)
            self.reopen()
            self.width_px = int(self.capture.get(cv2.CAP_PROP_FRAME_WIDTH))
            self.height_px = int(self.capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
            self._check()
        except BaseException:
            self.close()
            raise
        rate_hz, frames = float(self.capture.get(cv2.CAP_PROP_FPS)), float(self.capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.rate_hz = rate_hz if 0.01 <= rate_hz < 1e6 else 0.0
        self.frames = int(frames) if start[8:12] == b"AVI " and 0 < frames < 1e9 else 0
        self.memory = MemoryLimit(max(OPENING_BYTES, FRAME_BYTES_PX * self.width_px * self.height_px))

    def reopen(self) -> None:
        """Reopens the file at its start; on failure `capture` is not open."""
        # One decoder thread: measured on 400x300 to 720x576, two take 20 to 40 % more CPU and are no faster. The path is
        # that of the checked descriptor; OpenCV would crash on names that are not UTF-8.
        with self.memory, quiet.silent():
            self.capture.open(path_of(self._file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])

    def check_end(self, count: int) -> None:
        """Raises BrokenFrame if a video that ended after count frames should have had more."""
        if count < self.frames:  # FFmpeg skips damaged frames
            raise BrokenFrame(f"{self.path}: {self.frames - count} of its {self.frames} frames cannot be decoded", DAMAGED)

    def _check(self) -> None:
        if not self.capture.isOpened() or self.width_px < 1 or self.height_px < 1:
            raise UserError(f"{self.path}: not a readable video, or too large to decode", REMEDY)
        if self.width_px * self.height_px > MAX_FRAME_PX:
            size = f"{self.width_px}x{self.height_px}"
            raise UserError(f"{self.path}: frames of {size} px; the limit is {MAX_FRAME_PX} px", "scale the video down")

    def close(self) -> None:
        self.capture.release()
        self._file.close()


class Video:
    """A `Recording` in any codec of FFmpeg."""

    packet: NDArray[np.uint8] | None = None

    def __init__(self, video: VideoFile) -> None:
        """Raises UserError if no frame can be decoded."""
        self._video, self._capture = video, video.capture
        self.width_px, self.height_px, self.rate_hz = video.width_px, video.height_px, video.rate_hz
        with video.memory:
            self._grabbed = self._capture.grab()
        self._count = 0  # frames since the start
        if not self._grabbed:
            raise UserError(f"{video.path}: not a readable video", REMEDY)
        self._scratch: NDArray[np.uint8] | None = None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """See `Recording.next`."""
        with self._video.memory:
            return self._next(out)

    def _next(self, out: NDArray[np.uint8]) -> int | None:
        if not self._grabbed and not self._capture.grab():
            self._grabbed = any(self._capture.grab() for _ in range(TRIES))
            if self._grabbed:
                self._count += 1
                raise BrokenFrame(f"{self._video.path}: frame {self._count - 1} cannot be decoded", DAMAGED)
            count, self._count = self._count, self._video.frames  # reported once per loop
            self._video.check_end(count)
            return None
        self._grabbed = False
        self._count += 1
        stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        same = out.shape == (self.height_px, self.width_px, 3)
        ok, frame = self._capture.retrieve(out if same else self._scratch)
        if not ok:
            raise BrokenFrame(f"{self._video.path}: frame {self._count - 1} cannot be decoded", DAMAGED)
        decoded = np.asarray(frame, np.uint8)
        if not same:
            self._scratch = decoded
        fitted(decoded, out)
        return stamp_ns

    def rewind(self) -> None:
        self._capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        if not self._capture.grab():  # a stream that cannot seek is reopened
            self._video.reopen()
            self._capture.grab()
        self._grabbed, self._count = True, 0

    def close(self) -> None:
        self._video.close()


class MotionJpeg:
    """A `Recording` of JPEGs: demuxed by FFmpeg, decoded like a camera's JPEGs, with the packets passed through.

    Measured at 640x480: 1.15 ms a frame, as with FFmpeg's own decoder.
    """

    def __init__(self, video: VideoFile) -> None:
        """Raises ValueError if its packets are not JPEGs of the size in the header; the caller then reopens the video."""
        self._video, self._capture = video, video.capture
        self.width_px, self.height_px, self.rate_hz = video.width_px, video.height_px, video.rate_hz
        self.packet: NDArray[np.uint8] | None = None
        self._ready: tuple[int, NDArray[np.uint8]] | None = None
        self._count = 0
        jpegs = self._capture.get(cv2.CAP_PROP_FOURCC) == cv2.VideoWriter.fourcc(*"MJPG")
        if jpegs and self._capture.set(cv2.CAP_PROP_FORMAT, -1):
            try:
                self._ready = self._decode_next()
            except BrokenFrame as error:
                raise ValueError(error.message) from None
        if self.packet is None:
            raise ValueError(f"{video.path}: not Motion JPEG, or two half pictures per packet")

    def _decode_next(self) -> tuple[int, NDArray[np.uint8]] | None:
        """Stamp in ns and picture of the next non-empty packet (AVI files have empty ones); None at the end."""
        with self._video.memory:
            return self._decoded()

    def _decoded(self) -> tuple[int, NDArray[np.uint8]] | None:
        while self._capture.grab():
            stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            taken, data = self._capture.retrieve()
            packet = np.asarray(data, np.uint8).reshape(-1) if taken else np.empty(0, np.uint8)
            self._count += 1
            if not packet.size:
                continue
            picture = picture_of(packet) if is_jpeg(packet) else None
            if picture is None:
                raise BrokenFrame(f"{self._video.path}: frame {self._count - 1} is not a decodable JPEG", DAMAGED)
            self.packet = packet if picture.shape == (self.height_px, self.width_px, 3) else None
            return stamp_ns, picture
        return None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """See `Recording.next`."""
        found, self._ready = self._ready or self._decode_next(), None
        if found is None:
            count, self._count = self._count, self._video.frames
            self._video.check_end(count)
            return None
        stamp_ns, picture = found
        fitted(picture, out)
        return stamp_ns

    def rewind(self) -> None:
        self._capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        self._count = 0
        self._ready = self._decode_next()
        if self._ready is None:  # a stream that cannot seek is reopened
            self._video.reopen()
            self._capture.set(cv2.CAP_PROP_FORMAT, -1)

    def close(self) -> None:
        self._video.close()


def open_video(file: BinaryIO, path: Path) -> Video | MotionJpeg:
    """Opens the video in file and takes ownership of file. Raises UserError if it is not a video or too large."""
    video = VideoFile(file, path)
    try:
        try:
            return MotionJpeg(video)
        except ValueError:
            video.reopen()
            return Video(video)
    except BaseException:
        video.close()
        raise
