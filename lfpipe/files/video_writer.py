"""The one writer of videos. .mp4 is H.264 by PyAV (FFmpeg's libraries in a wheel): smallest, for
any player, half the chroma. .avi is Motion JPEG: larger, for any player, without PyAV. .mkv keeps
every value, because chroma separates the two eyes of an anaglyph.

H.264: colours are BT.709 and tagged as such.
"""

from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import opencv_name
from lfpipe.files.output import PLACE
from lfpipe.files.safe_files import reason
from lfpipe.host.machine import install_command

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
