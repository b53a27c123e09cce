"""Picture files: headers by Pillow, pixels by OpenCV, which keeps 16 bits (AVIF and animations by Pillow)."""

import contextlib
import io
import os
import warnings
from pathlib import Path
from typing import IO, Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile

from lfpipe.errors import UserError
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import path_of

MAX_DECODING_BYTES = 240_000_000  # 8192x8192 px of 8-bit colour, 7574x5264 px (lenslets of a Lytro Illum) of 16-bit colour
FORMATS = ("PNG", "JPEG", "PPM", "BMP", "TIFF", "WEBP", "AVIF", "GIF")
_GREY = ("1", "L", "I", "I;16", "I;16B", "I;16L")  # Pillow's modes of one sample per pixel
_ORIENTATION = 0x0112  # EXIF's tag
_TAIL, _ENDS = 1 << 16, {"JPEG": b"\xff\xd9", "PNG": b"IEND"}
warnings.filterwarnings("ignore", module="PIL")  # about damage that costs no picture
Image.MAX_IMAGE_PIXELS = None  # MAX_DECODING_BYTES is the limit, and it counts bytes


@attrs.frozen
class Header:
    """What a picture's header says. width_px, height_px: upright. grey: one sample per pixel, neither colour nor alpha.
    max_value: the full-scale value, above 255 for samples of two bytes. orientation: of the stored picture, 1 (upright) to 8, as
    EXIF counts. frames: of an animation, or pictures in one file."""

    format: str
    width_px: int
    height_px: int
    grey: bool = False
    max_value: int = 255
    orientation: int = 1
    frames: int = 1

    @property
    def stored_shape(self) -> tuple[int, ...]:
        """Of the array that a decoder gives; a quarter turn exchanges height and width."""
        size = (self.width_px, self.height_px) if self.orientation >= 5 else (self.height_px, self.width_px)
        return size if self.grey else (*size, 3)

    @property
    def decoded_bytes(self) -> int:
        """Size of the decoded picture, with one or three samples per pixel."""
        return self.width_px * self.height_px * (1 if self.grey else 3) * (2 if self.max_value > 255 else 1)


def header_of(data: bytes | memoryview) -> Header | None:
    """The header of a picture in memory; None if its format is not supported."""
    return _header(io.BytesIO(data))


def _header(file: IO[bytes]) -> Header | None:
    try:
        with Image.open(file, formats=FORMATS) as image:
            kind = "JPEG" if image.format == "MPO" else str(image.format)
            if image.mode == "F" or min(image.size) < 1:
                return None
            turn = 1
            with contextlib.suppress(Exception):  # damaged: the picture is shown as stored
                exif = Image.Exif()  # `image.getexif` would decode a PNG
                exif.load(image.info.get("exif", b"") if kind != "TIFF" else b"")  # OpenCV turns TIFF files
                turn = int(exif.get(_ORIENTATION, 1))
            width, height = image.size[::-1] if 5 <= turn <= 8 else image.size
            grey, full = image.mode in _GREY, _full_value(image)
            return Header(kind, width, height, grey, full, turn if 1 <= turn <= 8 else 1, getattr(image, "n_frames", 1))
    except Exception:  # Pillow's parsers raise many kinds for damage
        return None


def _full_value(image: ImageFile.ImageFile) -> int:
    """The full-scale value of the stored samples, by what Pillow would decode them with."""
    codec, args = (image.tile[0].codec_name, image.tile[0].args) if image.tile else ("", "")
    if codec.startswith("ppm") and isinstance(args, tuple):  # (mode, full value)
        return max(255, int(args[1]))
    return 65535 if ";16" in str(args) or image.mode.startswith("I") else 255


def _unreadable(path: Path, why: str) -> UserError:
    return UserError(f"{path}: not a readable picture ({why})", "download or export it again")


def _checked(path: Path, file: IO[bytes]) -> Header:
    header = _header(file)
    if header is None:
        file.seek(4)
        if file.read(4) == b"ftyp":
            raise UserError(f"{path}: a HEIC picture under another name", "export it as JPEG")
        raise _unreadable(path, "truncated, damaged or another format")
    if header.decoded_bytes > MAX_DECODING_BYTES:
        most = f"at most {MAX_DECODING_BYTES / 1e6:.0f} MB are allowed"
        claim = f"{header.width_px}x{header.height_px} px, {header.decoded_bytes / 1e6:.0f} MB"
        raise _unreadable(path, f"it claims {claim}; {most}")
    if header.format in _ENDS:
        size = os.fstat(file.fileno()).st_size
        file.seek(max(0, size - _TAIL))
        if _ENDS[header.format] not in file.read(_TAIL):
            raise _unreadable(path, f"truncated: a {header.format} file without its end")
    return header


def open_header(path: Path) -> Header:
    """The header of a picture. Raises UserError if it is no picture, too large to decode or certainly truncated."""
    with open_file(path) as file:
        return _checked(path, file)


def _decode(path: Path, file: IO[bytes], header: Header) -> NDArray[Any]:
    """The stored pixels, grey or BGR. Raises UserError if they differ from the header in size or type."""
    if header.format in ("AVIF", "GIF"):
        try:
            file.seek(0)
            with Image.open(file, formats=FORMATS) as image:
                out = np.array(image.convert("L" if header.grey else "RGB"))
        except Exception:
            raise _unreadable(path, "damaged") from None
        return out if header.grey else np.asarray(cv2.cvtColor(out, cv2.COLOR_RGB2BGR))
    deep = header.max_value > 255
    flags = (cv2.IMREAD_GRAYSCALE if header.grey else cv2.IMREAD_COLOR) | (cv2.IMREAD_ANYDEPTH if deep else 0)
    pixels = _imread(file, flags)
    if pixels is None or pixels.shape != header.stored_shape or pixels.dtype != (np.uint16 if deep else np.uint8):
        raise _unreadable(path, "truncated, damaged or not what its header claims")
    return pixels


def _imread(file: IO[bytes], flags: int) -> NDArray[Any] | None:
    """The pixels as stored; None where OpenCV cannot read them."""
    with contextlib.suppress(cv2.error):
        return cv2.imread(path_of(file), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    return None


def _unchanged(path: Path, file: IO[bytes], like: Header | None) -> Header:
    header = _checked(path, file)
    if like is not None and header != like:
        raise UserError(f"{path}: changed while it was read", "try again once the files are complete")
    return header


def read_picture(path: Path, like: Header | None = None) -> tuple[NDArray[Any], int]:
    """A picture's own values, upright, and the full value: ((h, w) or (h, w, 3) RGB, uint8 or uint16, max_value).

    Keeps the file's bit depth (a 10-bit PPM holds 0..1023; OpenCV's default would shift it to 0..3). Drops an alpha plane; of an
    animation, gives the first frame. like: the result of `open_header` for the path. Raises UserError if the file is truncated,
    no picture, too large, or has changed since.
    """
    with open_file(path) as file:
        header = _unchanged(path, file, like)
        pixels = _decode(path, file, header)
    if not header.grey:  # OpenCV's IMREAD_COLOR_RGB does not convert 16-bit TIFF files
        cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB, dst=pixels)
    return upright(pixels, header.orientation), header.max_value


def read_frames(path: Path, most_bytes: int = MAX_DECODING_BYTES) -> list[NDArray[np.uint8]]:
    """All frames of an animation or all pictures of one file (GIF, WebP, MPO), uint8 (h, w, 3) RGB, upright. Raises UserError."""
    with open_file(path) as file:
        header = _checked(path, file)
        if header.frames * header.decoded_bytes > most_bytes:
            size = f"{header.frames} frames of {header.width_px}x{header.height_px} px"
            raise UserError(f"{path}: {size} are too many to decode at once", "give its frames as pictures in a folder")
        frames = []
        try:
            file.seek(0)
            with Image.open(file, formats=FORMATS) as image:
                for number in range(header.frames):
                    image.seek(number)
                    frames.append(upright(np.array(image.convert("RGB")), header.orientation))
        except Exception:
            raise _unreadable(path, f"damaged after {len(frames)} frames") from None
    return frames


def small_grey(path: Path, like: Header, most_px: float) -> NDArray[np.uint8]:
    """A picture in grey, uint8 (h, w); a JPEG much larger than most_px is decoded at 1/2, 1/4 or 1/8 of its size, but not far
    below most_px. like: the result of `open_header` for the path. Raises UserError.
    """
    pixels = like.width_px * like.height_px
    reduced = [k for k in (2, 4, 8) if like.format == "JPEG" and pixels >= 0.75 * most_px * k * k]
    if not reduced:
        picture, full = read_picture(path, like)
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        return np.asarray(grey if full == 255 else cv2.convertScaleAbs(grey, alpha=255 / full), np.uint8)
    with open_file(path) as file:
        _unchanged(path, file, like)
        small = _imread(file, getattr(cv2, f"IMREAD_REDUCED_GRAYSCALE_{reduced[-1]}"))
    if small is None:
        raise _unreadable(path, "truncated, damaged or not what its header claims")
    return np.asarray(upright(small, like.orientation), np.uint8)


def upright(picture: NDArray[Any], orientation: int) -> NDArray[Any]:
    """A stored picture as EXIF's orientation (1 to 8) shows it; overwrites it unless that is a quarter turn."""
    if orientation >= 5:
        picture = np.asarray(cv2.transpose(picture))
    code = {2: 1, 3: -1, 4: 0, 6: 1, 7: -1, 8: 0}.get(orientation)
    return picture if code is None else np.asarray(cv2.flip(picture, code, dst=picture))
