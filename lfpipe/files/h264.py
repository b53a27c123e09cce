"""H.264 in MP4 by PyAV (FFmpeg's libraries in a wheel), for videos that any player opens. Lossy, with half the chroma resolution.

Colours are BT.709 and tagged as such. The file is written in fragments and converted to an ordinary MP4 at its end, so a file
whose writer was killed lacks at most its last two seconds.
"""

import contextlib
import importlib.util
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.output import MARK
from lfpipe.files.safe_files import reason

ENCODERS = ("libx264", "libopenh264", "h264_videotoolbox", "h264_mf")
QUALITY = "18"  # x264's constant rate factor: nearly indistinguishable from the original
BT709 = 1
PLACE = "name a file in an existing directory that you may write to"


def encoder_name() -> str:
    """Name of the H.264 encoder. Raises UserError if there is none."""
    if importlib.util.find_spec("av") is None:
        raise UserError("no H.264 encoder: PyAV is not installed", "pip install 'lfpipe[media]'; .mkv and .gif do not need it")
    import av

    found = next((name for name in ENCODERS if name in av.codecs_available), "")
    if not found:
        raise UserError(f"no H.264 encoder in PyAV {av.__version__}", "install PyAV from PyPI; .mkv and .gif do not need it")
    return found


class H264Writer:
    """Writes pictures of one size at a constant rate. An odd row or column is repeated once: H.264 needs even sizes.

    Raises UserError if there is no encoder, OSError if the file cannot be written.
    """

    def __init__(self, path: Path, size_px: tuple[int, int], rate_hz: float, survives: bool = True) -> None:
        """size_px: (width, height). The index ("moov") comes first in the finished file, as web pages and some players expect.
        survives: write fragments, so that a file whose writer was killed can be read, and move the index at the end."""
        from av import open as open_container

        name, make = encoder_name(), cast(Any, open_container)  # its stubs cover every kind of stream
        self._path, self._survives = path, survives
        self._file = path.open("wb")
        try:
            where = self._file if survives else f"file:{path}"  # FFmpeg reads the file again to move its index
            flags = {"movflags": "hybrid_fragmented" if survives else "faststart"}
            self._container = make(where, "w", format="mp4", options=flags)
            self._container.metadata["comment"] = MARK.decode()
            self._stream = self._container.add_stream(name, rate=Fraction(rate_hz).limit_denominator(1001))
            self._stream.width, self._stream.height = (n + n % 2 for n in size_px)
            self._stream.pix_fmt = "yuv420p"
            self._stream.options = {"crf": QUALITY, "preset": "veryfast"} if name == "libx264" else {}
            coder = self._stream.codec_context
            coder.colorspace = coder.color_primaries = coder.color_trc = BT709
            coder.color_range = 1  # limited
            coder.gop_size = max(1, round(2 * rate_hz))  # a fragment begins with a key frame
            coder.thread_count = 1  # sessions plan one thread per core
        except BaseException:
            self._file.close()
            raise

    def write(self, picture: NDArray[np.uint8]) -> None:
        """The next picture, uint8 (height, width, 3) BGR. Raises OSError if the disk is full."""
        import av

        height, width = self._stream.height, self._stream.width
        if picture.shape[:2] != (height, width):
            picture = np.pad(picture, ((0, height - picture.shape[0]), (0, width - picture.shape[1]), (0, 0)), "edge")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="bgr24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=BT709, dst_color_range=1)
        self._container.mux(self._stream.encode(frame))

    def release(self) -> None:
        """Ends the file, with its index first. Raises OSError if the disk is full."""
        try:
            self._container.mux(self._stream.encode())
            self._container.close()
        finally:
            with contextlib.suppress(OSError):
                self._file.close()
        if self._survives:
            _move_index_first(self._path)


def _move_index_first(path: Path) -> None:
    """Copies the finished packets beside path and replaces it. Without room for the copy, the file stays: every player opens
    it."""
    from av import open as open_container
    from av.error import FFmpegError

    new, open_any = path.with_name(f".{path.name[:200]}.index"), cast(Any, open_container)
    try:
        options = {"movflags": "faststart"}
        with open_any(f"file:{path}") as old, open_any(f"file:{new}", "w", format="mp4", options=options) as made:
            stream = made.add_stream_from_template(old.streams.video[0])
            made.metadata.update(old.metadata)
            for packet in old.demux(video=0):
                if packet.dts is not None:  # the last one is empty
                    packet.stream = stream
                    made.mux(packet)
        new.chmod(path.stat().st_mode)
        new.replace(path)
    except (OSError, FFmpegError):
        new.unlink(missing_ok=True)


def write_error(path: Path, error: OSError) -> UserError:
    """The UserError for a file that cannot be written."""
    return UserError(f"{path}: cannot be written: {reason(error)}", PLACE)
