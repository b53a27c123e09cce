"""A video file: of a scene, whose frames are pictures of it, or as a recording of a camera.

A container's claims about its frames may differ from its stream, and only decoding reveals that. In
the packer, a decoder that runs out of memory, crashes or hangs means a refusal; as a recording, it
has a limit of memory of its own.
"""

import contextlib
import os
import re
from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache, partial
from importlib.util import find_spec
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

# FFmpeg prints straight to stderr, past Python; a UserError here reports the broken file
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.codecs import (
    ENDS_BYTES,
    MAX_FRAMES,
    BrokenFrame,
    codec_name,
    is_jpeg,
    is_video,
    picture_of,
)
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import MemoryLimit, proc_fd_path
from lfpipe.host.terminal import opencv_logging
from lfpipe.host.worker import install_command

OPENING_BYTES = 200_000_000  # memory limit of a decoder before the frame size is known
FRAME_BYTES_PX = 20  # memory limit per pixel afterwards; measured: 6 to 15 with FFV1, MPEG-4, VP9
MAX_FRAME_PX = 22_000_000  # 9x9 views of 512x512; OpenCV holds a frame three times
USUAL_RATE_HZ = 25.0  # for a video without a rate
TRIES = 16  # an undecodable frame looks like the end, unless a later one decodes
# Kinds of recordings besides those of `is_video`.
# FFmpeg would also follow playlists of other files and addresses.
RECORDED_KINDS = (
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
_LOOKS = 9  # frames of a video that are compared to find one that shows something
# what declares a video stream: in Matroska before its first cluster, in AVI, MP4 and QuickTime
_MATROSKA, _CLUSTER = re.compile(rb"\x83\x81\x01"), b"\x1f\x43\xb6\x75"
_DECLARED = re.compile(rb"strh.{4}vids|hdlr.{8}vide", re.DOTALL)
_SECOND_LAYER = b"lhvC"  # box of MV-HEVC's second view
_DECODES_LAYERS = (61, 19)  # libavcodec of FFmpeg 7.1, which PyAV's wheels have since 14.0
Retrieved = tuple[int, NDArray[np.uint8] | None]  # stamp in ns, and pixels or a JPEG
Retrieve = Callable[[], Retrieved]
_REMEDY = "play it with another program, or export it again"


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
    """Frames of a video by number; starts over if they are not read in order. FFmpeg decodes, in
    OpenCV, or in PyAV what that cannot: more codecs, each of several streams, and both layers of
    MV-HEVC.

    Motion JPEG of a recording is only demuxed by it and decoded like a camera's JPEGs, and its
    packets are passed through: at 640x480 1.15 ms a frame, as with FFmpeg's own decoder.

    width_px, height_px: frame size in the header. rate_hz: 0 if unknown. jpeg: its frames are
    JPEGs.
    """

    def __init__(self, path: Path, stream: int = 0, recording: bool = False) -> None:
        """stream: which of several video streams or layers; the second one needs PyAV. recording:
        of a camera. Raises UserError if it is not a video, too large, or has no frames.
        """
        self._path = path
        self._number = stream
        self._file = open_file(path)
        self._recording = recording
        self._by_av = stream > 0
        self.jpeg = False
        self.width_px = self.height_px = self._fourcc = 0
        self._frames: Iterator[Retrieve | None] = iter(())
        # A stream may change its size midway. In the packer, threads share the limit of that.
        self._memory = MemoryLimit(OPENING_BYTES) if recording else contextlib.nullcontext()
        try:
            start = self._file.read(16)
            if not is_video(start) and not (recording and start.startswith(RECORDED_KINDS)):
                raise UserError(
                    f"{path}: not a readable video (MP4, QuickTime, Matroska, WebM or AVI)", _REMEDY
                )
            if not self._opens():
                self._by_av = True
                if not find_spec("av") or not self._opens():
                    more = f"; or {install_command('av')}, which decodes AV1"
                    raise UserError(
                        f"{path}: not a readable video: no frame can be decoded (codec"
                        f" {codec_name(self._fourcc, self._file)})",
                        f"export it again as H.264{'' if find_spec('av') else more}",
                    )
        except BaseException:
            self.close()
            raise

    def _opens(self) -> bool:
        """Opens it, and takes size and rate; whether its first frame can be decoded. Raises
        UserError.
        """
        motion_jpeg = self._start()
        size_px = self.width_px * self.height_px
        if size_px > MAX_FRAME_PX:
            raise UserError(
                f"{self._path}: frames of {self.width_px}x{self.height_px} px; the limit is"
                f" {MAX_FRAME_PX} px",
                "scale the video down",
            )
        if size_px < 1:
            return False
        if self._recording:
            self._memory = MemoryLimit(max(OPENING_BYTES, FRAME_BYTES_PX * size_px))
        for jpeg in (True, False) if motion_jpeg and self._recording else (False,):
            self.jpeg = jpeg
            self._next = MAX_FRAMES  # `read` starts over: on few threads, if frames are large
            with contextlib.suppress(BrokenFrame):
                first = self.read(0)
                if first is not None and (first.packet is not None or not jpeg):
                    return True  # not a half picture
        return False

    def _start(self) -> bool:
        """Starts from the first frame: reopens the file, because not every stream can seek. Whether
        it is Motion JPEG. Raises UserError.
        """
        self._next = 0
        if self._by_av:
            try:
                self._frames = self._open_by_av()
            except Exception:  # PyAV raises many kinds for damage, or is not there
                if is_spatial(self._path):
                    raise _second_layer(self._path) from None
                raise UserError(
                    f"{self._path}: its video stream {self._number + 1} cannot be read", _REMEDY
                ) from None
            return False
        # As a recording, one decoder thread: measured on 400x300 to 720x576, two take 20 to 40 %
        # more CPU and are no faster. Each holds frames of its own: large ones are decoded by one.
        # The path is that of the checked descriptor; OpenCV would crash on names that are not
        # UTF-8.
        threads = 1 if self._recording or self.width_px * self.height_px > 12_000_000 else 2
        with self._memory, opencv_logging():
            capture = cv2.VideoCapture(
                proc_fd_path(self._file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, threads]
            )
            if self.jpeg:
                capture.set(cv2.CAP_PROP_FORMAT, -1)
        self._set_format(
            int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
            float(capture.get(cv2.CAP_PROP_FPS)),
        )
        self._frames = _grabbed(capture)
        self._fourcc = int(capture.get(cv2.CAP_PROP_FOURCC))
        return self._fourcc == cv2.VideoWriter.fourcc(*"MJPG")

    def _set_format(self, width_px: int, height_px: int, rate_hz: float) -> None:
        self.width_px, self.height_px = width_px, height_px
        self.rate_hz = rate_hz if 0.01 <= rate_hz < 1e6 else 0.0

    def _open_by_av(self) -> Iterator[Retrieve | None]:
        import av

        self._file.seek(0)
        container = av.open(self._file, "r")
        layers = is_spatial(self._path)
        stream = container.streams.video[0 if layers else self._number]
        if layers and av.library_versions["libavcodec"] < _DECODES_LAYERS:
            raise RuntimeError("this FFmpeg decodes one layer only")
        if layers:
            stream.codec_context.options = {"view_ids": "-1"}
        self._set_format(stream.width, stream.height, float(stream.average_rate or 0))
        frames = container.decode(stream)
        return _decoded(islice(frames, self._number, None, 2) if layers else frames)

    @cached_property
    def frames(self) -> int:
        """The number of decodable frames."""
        self._start()
        count = sum(1 for _ in takewhile(bool, islice(self._frames, MAX_FRAMES)))
        self._next = MAX_FRAMES  # `read` starts over
        return count

    def read(self, number: int) -> RecordedFrame | None:
        """A frame; None after the end. Raises BrokenFrame if it cannot be decoded."""
        if number < self._next:
            self._start()
        with self._memory:
            items = islice(self._frames, number - self._next, None)
            self._next = number + 1
            for retrieve in items:
                stamp_ns, data = retrieve() if retrieve else (0, None)
                if data is None or data.size:  # AVI files have empty ones
                    break
            else:
                return None
            picture = data
            if self.jpeg and data is not None:
                data = data.reshape(-1)
                picture = picture_of(data) if is_jpeg(data) else None
            if picture is None:
                raise BrokenFrame(f"{self._path}: frame {number} cannot be decoded", _REMEDY)
            own_size = picture.shape == (self.height_px, self.width_px, 3)
            return RecordedFrame(stamp_ns, picture, data if self.jpeg and own_size else None)

    def rgb(self, number: int) -> NDArray[Any]:
        """A frame of a scene, uint8 (height, width, 3). Raises UserError."""
        frame = self.read(number)
        if frame is None or frame.picture.shape != (self.height_px, self.width_px, 3):
            raise UserError(f"{self._path}: frame {number} cannot be decoded", _REMEDY)
        return np.asarray(cv2.cvtColor(frame.picture, cv2.COLOR_BGR2RGB, dst=frame.picture))

    def close(self) -> None:
        """Releases the decoder and the file."""
        self._frames = iter(())
        self._file.close()


def _grabbed(capture: cv2.VideoCapture) -> Iterator[Retrieve | None]:
    """What retrieves each frame of OpenCV, None for one that cannot be decoded: it looks like the
    end, unless a later one decodes.
    """
    missed = 0
    while missed <= TRIES:
        if not capture.grab():
            missed += 1
            continue
        if missed:
            yield None
        missed = 0
        yield partial(_retrieved, capture)


def _retrieved(capture: cv2.VideoCapture) -> Retrieved:
    good, data = capture.retrieve()
    stamp_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
    return stamp_ns, np.asarray(data, np.uint8) if good else None


def _decoded(frames: Iterator[Any]) -> Iterator[Retrieve | None]:
    """What retrieves each frame of PyAV, up to the first that cannot be decoded."""
    from av.error import FFmpegError

    with contextlib.suppress(FFmpegError):
        for frame in frames:
            yield partial(_converted, frame)


def _converted(frame: Any) -> Retrieved:
    return round(1e9 * float(frame.time or 0)), frame.to_ndarray(format="bgr24")


def is_spatial(path: Path) -> bool:
    """Whether a film is a spatial one: MV-HEVC, with a layer for each eye. Raises UserError."""
    start, end = film_ends(path)
    return _SECOND_LAYER in start + end and not start.startswith(b"\x1aE")


def _second_layer(path: Path) -> UserError:
    """The error for a spatial film of which only one layer can be decoded here."""
    stack = '"[0:v:view:0][0:v:view:1]hstack"'
    return UserError(
        f"{path}: a spatial video (MV-HEVC), whose second view cannot be read here",
        f"{install_command('av>=14')}; or convert it with FFmpeg 7.1 or later: `ffmpeg -i"
        f" {path.name} -filter_complex {stack} {path.stem}_SBS.mp4`",
    )


def film_ends(path: Path) -> tuple[bytes, bytes]:
    """The two ends of a film, which hold its headers. Raises UserError."""
    with open_file(path) as file:
        start = file.read(ENDS_BYTES)
        file.seek(max(len(start), path.stat().st_size - ENDS_BYTES))
        return start, file.read()


@lru_cache(maxsize=4)
def telling_frame(path: Path, stream: int = 0) -> tuple[int, NDArray[Any]]:
    """(number, picture) of the first frame with much detail, of a few: frames that fade in from
    black decide nothing. Raises UserError.
    """
    video = Video(path, stream)
    numbers = sorted({round(at) for at in np.linspace(0, video.frames - 1, _LOOKS)})
    pictures = [video.rgb(number) for number in numbers]
    details = [float(cv2.Laplacian(picture[..., 1], cv2.CV_32F).std()) for picture in pictures]
    first = next(k for k, detail in enumerate(details) if detail >= max(details) / 2)
    return numbers[first], pictures[first]


@lru_cache(maxsize=4)
def stream_count(path: Path) -> int:
    """The number of a file's video streams. Raises UserError."""
    start, end = film_ends(path)
    if start.startswith(b"\x1aE"):
        return len(_MATROSKA.findall(start.partition(_CLUSTER)[0]))
    return len(_DECLARED.findall(start) or _DECLARED.findall(end))


def second_stream(path: Path) -> list[str]:
    """What is said of a second stream that is not used; [] if there is none."""
    if stream_count(path) < 2:
        return []
    why = f"reading it needs another package: {install_command('av')}"
    if find_spec("av"):
        why = "it is not the other picture of a stereo pair"
    return [f"the second video stream of {path.name} is not used: {why}"]
