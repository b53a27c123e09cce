"""Decodes pictures into ring slots, and writes videos.

JPEGs of every source are decoded here, so that recordings replay to the same bits. Of videos, .mp4
is H.264 by PyAV (FFmpeg's libraries in a wheel): smallest, for any player, half the chroma; colours
are BT.709 and tagged as such. .avi is Motion JPEG: larger, for any player, without PyAV. .mkv keeps
every value, because chroma separates the two eyes of an anaglyph.
"""

import os
import re
from fractions import Fraction
from pathlib import Path
from typing import IO, Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError, plain
from lfpipe.files.pictures import MAX_DECODING_BYTES, header_of
from lfpipe.files.safe_files import PLACE, reason
from lfpipe.host.worker import install_command

# first boxes of MP4 and QuickTime files
_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot")
# codecs as MP4 and QuickTime name them, in either end of a file, and as Matroska does
_CODEC = re.compile(rb"stsd.{12}(\w{4})|(V_[A-Z0-9/]{3,20})", re.DOTALL)
ENDS_BYTES = 1 << 20  # of a file: they hold what declares its streams
# of a video or a recording: 9.7 hours at 30 Hz; those of a recording take 65 bytes of memory each
MAX_FRAMES = 1 << 20


class BrokenFrame(UserError):
    """A frame of a recording that cannot be decoded: it is lost, the next one may be read."""


def opencv_name(path: Path) -> str:
    """Returns path for OpenCV. Raises UserError if it is not UTF-8, because OpenCV would crash."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise UserError(
            f"{path}: names of videos must be UTF-8", "rename the file or its folder"
        ) from None
    return str(path)


def is_video(start: bytes) -> bool:
    """Whether a file begins like MP4, QuickTime, Matroska, WebM or AVI.

    FFmpeg would also read others, such as file lists.
    """
    return (
        start[4:8] in _BOXES
        or start[:4] == b"\x1aE\xdf\xa3"
        or (start[:4] == b"RIFF" and start[8:12] == b"AVI ")
    )


def codec_name(number: int, file: IO[bytes]) -> str:
    """The name of a video's codec, for messages: its FourCC as the decoder knows it, or as the file
    says.
    """
    if number > 0:
        return plain(number.to_bytes(4, "little").decode("latin-1").strip("\0 "))
    file.seek(0)
    match = _CODEC.search(file.read(ENDS_BYTES))
    if match is None:
        file.seek(max(0, file.seek(0, os.SEEK_END) - ENDS_BYTES))
        match = _CODEC.search(file.read())
    return "unknown" if match is None else (match[1] or match[2]).decode()


def is_jpeg(data: NDArray[np.uint8]) -> bool:
    """Whether data, uint8 (n,), begins like a JPEG: start of image, and of the first marker."""
    return data[:3].tobytes() == b"\xff\xd8\xff"


def picture_of(data: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Decodes data, uint8 (n,), to uint8 (height, width, 3) BGR with its orientation applied; None
    if it cannot be decoded.

    The header is read first: a picture that would take too much memory is not decoded.
    """
    header = header_of(data.data)
    # imdecode needs two of three bytes for each pixel
    if header is None or 6 * header.width_px * header.height_px > MAX_DECODING_BYTES:
        return None
    try:
        picture = cv2.imdecode(data, cv2.IMREAD_COLOR)
    except cv2.error:
        return None
    return None if picture is None else np.asarray(picture, np.uint8)


def fit_area(picture_px: tuple[int, int], area_px: tuple[int, int]) -> tuple[int, int, int, int]:
    """The largest (x, y, width, height) of the picture's aspect in the middle of the area; both
    sizes are (width, height).
    """
    width, height = picture_px
    scale = min(area_px[0] / width, area_px[1] / height)
    fit_w = max(1, min(area_px[0], round(width * scale)))
    fit_h = max(1, min(area_px[1], round(height * scale)))
    return (area_px[0] - fit_w) // 2, (area_px[1] - fit_h) // 2, fit_w, fit_h


def fitted(frame: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Writes frame to out, unless the decoder has already done so.

    Pixels stay square: a frame of another aspect ratio is scaled to fit, with black bars. Faces are
    not distorted or cropped.
    """
    if frame.shape == out.shape:
        if frame.ctypes.data != out.ctypes.data:
            np.copyto(out, frame)
    else:
        height, width = out.shape[:2]
        x, y, w, h = fit_area((frame.shape[1], frame.shape[0]), (width, height))
        out[:y], out[y + h :], out[y : y + h, :x], out[y : y + h, x + w :] = 0, 0, 0, 0
        cv2.resize(frame, (w, h), dst=out[y : y + h, x : x + w], interpolation=cv2.INTER_LINEAR)


def fit_note(frame_px: tuple[int, int], out_px: tuple[int, int]) -> str:
    """Describes, for people, what `fitted` does with frames of another size; both are (width,
    height).
    """
    x, y, width, height = fit_area(frame_px, out_px)
    bars = ", with black bars " + ("at the sides" if x > y else "above and below") if x or y else ""
    return f"frames of {frame_px[0]}x{frame_px[1]} are scaled to {width}x{height}{bars}"


ENCODER = "libx264"
# An MP4 has its index first, as web pages and some players expect; or it is written in fragments
# until its end, so that it lacks at most two seconds if its writer is killed.
INDEX_FIRST, IN_FRAGMENTS = "faststart", "hybrid_fragmented"
QUALITY = "18"  # x264's constant rate factor: nearly indistinguishable from the original
BT709 = 1  # its number in FFmpeg
# Of the encoders in OpenCV's wheel, HuffYUV (on RGB), FFV1, PNG and raw RGBA preserve every RGB
# value. Measured on 512x512 anaglyphs: 1.3, 13, 74 and 0.6 ms a picture, 0.30, 0.23, 0.31 and 1.0
# MB. HuffYUV is the cheapest that is not raw.
# Motion JPEG by FFmpeg: 0.04 MB a picture of the demo, 43 dB of luma. OpenCV's own writer, 0.08 MB
# and 46 dB, has no files above 2 GB.
CODECS = {".mkv": "HFYU", ".avi": "MJPG"}


def require_encoder() -> None:
    """Raises UserError if there is no H.264 encoder."""
    try:
        from av import codecs_available
    except ImportError:
        codecs_available = set()
    if ENCODER not in codecs_available:
        raise UserError(
            "no H.264 encoder: PyAV of PyPI is not installed",
            f"{install_command('av')}; .avi, .mkv and .gif do not need it",
        )


class VideoWriter:
    """Writes pictures of one size at a constant rate. An odd row or column is repeated once:
    encoders need even sizes.

    Raises UserError if there is no encoder or the file cannot be created.
    """

    def __init__(
        self, path: Path, size_px: tuple[int, int], rate_hz: float, mp4: str = INDEX_FIRST
    ) -> None:
        """size_px: (width, height). mp4: INDEX_FIRST or IN_FRAGMENTS."""
        codec = CODECS.get(path.suffix.lower())
        self._by_opencv: cv2.VideoWriter | None = None
        self.size_px = size_px[0] + size_px[0] % 2, size_px[1] + size_px[1] % 2
        if codec is not None:
            name, code = opencv_name(path.absolute()), cv2.VideoWriter.fourcc(*codec)
            self._by_opencv = cv2.VideoWriter(name, cv2.CAP_FFMPEG, code, rate_hz, self.size_px)
            if not self._by_opencv.isOpened():
                raise UserError(
                    f"{path}: cannot write a video of {size_px[0]}x{size_px[1]} at {rate_hz:g} Hz",
                    PLACE,
                )
            return
        from av import open as open_container

        require_encoder()
        make = cast(Any, open_container)  # its stubs cover every kind of stream
        try:
            options = {"movflags": mp4, "flush_packets": "1"}
            self._container = make(f"file:{path}", "w", format="mp4", options=options)
        except OSError as error:
            raise write_error(path, error) from None
        self._stream = self._container.add_stream(
            ENCODER, rate=Fraction(rate_hz).limit_denominator(1001)
        )
        self._stream.width, self._stream.height = self.size_px
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"crf": QUALITY, "preset": "veryfast"}
        coder = self._stream.codec_context
        coder.colorspace = coder.color_primaries = coder.color_trc = BT709
        coder.color_range = 1  # limited
        coder.gop_size = max(1, round(2 * rate_hz))  # a fragment begins with a key frame
        coder.thread_count = 1  # sessions plan one thread per core

    def write(self, picture: NDArray[np.uint8]) -> None:
        """The next picture, uint8 (height, width, 3) BGR.

        Raises OSError if the disk is full; only .mp4 notices it.
        """
        rows, cols = self.size_px[1] - picture.shape[0], self.size_px[0] - picture.shape[1]
        if rows or cols:
            picture = np.pad(picture, ((0, rows), (0, cols), (0, 0)), "edge")
        if self._by_opencv is not None:
            self._by_opencv.write(picture)
            return
        import av

        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="bgr24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=BT709, dst_color_range=1)
        self._container.mux(self._stream.encode(frame))

    def release(self) -> None:
        """Ends the file. Raises OSError if the disk is full."""
        if self._by_opencv is not None:
            self._by_opencv.release()
        else:
            self._container.mux(self._stream.encode())
            self._container.close()


def write_error(path: Path, error: OSError) -> UserError:
    """The UserError for a file that cannot be written."""
    return UserError(f"{path}: cannot be written: {reason(error)}", PLACE)
