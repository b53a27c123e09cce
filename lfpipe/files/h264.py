"""H.264 in MP4 by PyAV (FFmpeg's libraries in a wheel), for videos that any player opens. Not lossless, and half the chroma.

Colours are those of BT.709, and the file says so. It is written in fragments and made an ordinary MP4 at its end: one whose
writer was killed plays up to its last two seconds.
"""

from __future__ import annotations

import contextlib
import importlib.util
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.safe_files import reason

ENCODERS = ("libx264", "libopenh264", "h264_videotoolbox", "h264_mf")
QUALITY = "18"  # x264's constant rate factor: hardly to be told from the original
BT709 = 1
PLACE = "a file in a directory that exists and that you may write to"


def encoder_name() -> str:
    """The H.264 encoder here. Raises UserError where there is none."""
    if importlib.util.find_spec("av") is None:
        raise UserError("no H.264 encoder: PyAV is not installed", "pip install 'lfpipe[media]'; .mkv and .gif need none")
    import av

    found = next((name for name in ENCODERS if name in av.codecs_available), "")
    if not found:
        raise UserError(f"no H.264 encoder in PyAV {av.__version__}", "PyAV from PyPI has libx264; .mkv and .gif need none")
    return found


class H264Writer:
    """Pictures of one size at an even rate. An odd row or column is repeated once: H.264 has even sizes.

    Raises UserError where there is no encoder, OSError where the file cannot be written.
    """

    def __init__(self, path: Path, size_px: tuple[int, int], rate_hz: float) -> None:
        """size_px: (width, height)."""
        from av import open as open_container

        name, make = encoder_name(), cast(Any, open_container)  # its stubs know streams of every kind
        self._file = path.open("wb")
        try:
            self._container = make(self._file, "w", format="mp4", options={"movflags": "hybrid_fragmented"})
            self._stream = self._container.add_stream(name, rate=Fraction(rate_hz).limit_denominator(1001))
            self._stream.width, self._stream.height = (n + n % 2 for n in size_px)
            self._stream.pix_fmt = "yuv420p"
            self._stream.options = {"crf": QUALITY, "preset": "veryfast"} if name == "libx264" else {}
            coder = self._stream.codec_context
            coder.colorspace = coder.color_primaries = coder.color_trc = BT709
            coder.color_range = 1  # limited
            coder.gop_size = max(1, round(2 * rate_hz))  # a fragment begins with a whole picture
            coder.thread_count = 1  # a thread a core is the plan
        except BaseException:
            self._file.close()
            raise

    def write(self, picture: NDArray[np.uint8]) -> None:
        """The next picture, uint8 (height, width, 3) BGR. Raises OSError where the disk is full."""
        import av

        height, width = self._stream.height, self._stream.width
        if picture.shape[:2] != (height, width):
            picture = np.pad(picture, ((0, height - picture.shape[0]), (0, width - picture.shape[1]), (0, 0)), "edge")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="bgr24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=BT709, dst_color_range=1)
        self._container.mux(self._stream.encode(frame))

    def release(self) -> None:
        """Ends the file. Raises OSError where the disk is full."""
        try:
            self._container.mux(self._stream.encode())
            self._container.close()
        finally:
            with contextlib.suppress(OSError):
                self._file.close()


def write_error(path: Path, error: OSError) -> UserError:
    """The mistake behind a file that cannot be written."""
    return UserError(f"{path}: cannot be written: {reason(error)}", PLACE)
