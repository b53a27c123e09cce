"""Decodes pictures into ring slots.

JPEGs of every source are decoded here, so that recordings replay to the same bits.
"""

import os
import re
from pathlib import Path
from typing import IO

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError, plain
from lfpipe.files.pictures import MAX_DECODING_BYTES, header_of

# first boxes of MP4 and QuickTime files
_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot")
# codecs as MP4 and QuickTime name them, in either end of a file, and as Matroska does
_CODEC = re.compile(rb"stsd.{12}(\w{4})|(V_[A-Z0-9/]{3,20})", re.DOTALL)
ENDS_BYTES = 1 << 20  # of a file: they hold what declares its streams
JPEG_START = b"\xff\xd8\xff"  # start of image, and of the first marker


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
    found = _CODEC.search(file.read(ENDS_BYTES))
    if found is None:
        file.seek(max(0, file.seek(0, os.SEEK_END) - ENDS_BYTES))
        found = _CODEC.search(file.read())
    return "unknown" if found is None else (found[1] or found[2]).decode()


def is_jpeg(data: NDArray[np.uint8]) -> bool:
    """Whether data, uint8 (n,), begins like a JPEG."""
    return data[: len(JPEG_START)].tobytes() == JPEG_START


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
