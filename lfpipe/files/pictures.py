"""Picture files: headers by Pillow, pixels by OpenCV, which keeps 16 bits (AVIF, HEIC and
animations by Pillow).
"""

import contextlib
import io
import os
import re
import warnings
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile

from lfpipe.errors import UserError
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import proc_fd_path

# 8192x8192 px of 8-bit colour, 7574x5264 px (lenslets of a Lytro Illum) of 16-bit colour
MAX_DECODING_BYTES = 240_000_000
FORMATS = ("PNG", "JPEG", "PPM", "BMP", "TIFF", "WEBP", "AVIF", "GIF", "HEIF")
_HEIC = re.compile(rb"....ftyp(hei|hev|mif1|msf1)", re.DOTALL)
_GREY = ("1", "L", "I", "I;16", "I;16B", "I;16L")  # Pillow's modes of one sample per pixel
_ORIENTATION = 0x0112  # EXIF's tag
# phones append data after a picture's end
_TAIL = 1 << 16
_ENDS = {"JPEG": b"\xff\xd9", "PNG": b"IEND"}
warnings.filterwarnings("ignore", module="PIL")  # about damage that costs no picture
Image.MAX_IMAGE_PIXELS = None  # MAX_DECODING_BYTES is the limit, and it counts bytes


@attrs.frozen(kw_only=True)
class Header:
    """The header of a picture."""

    format: str
    width_px: int
    """Upright."""
    height_px: int
    """Upright."""
    grey: bool = False
    """One sample per pixel, neither colour nor alpha."""
    max_value: int = 255
    """The full-scale value, above 255 for samples of two bytes."""
    orientation: int = 1
    """Of the stored picture, 1 (upright) to 8, as EXIF counts."""
    frames: int = 1
    """Of an animation, or pictures in one file."""
    eyes: tuple[int, ...] = ()
    """Which frames are the left and the right eye's; empty if unknown."""
    has_depth: bool = False
    """As a part of a HEIC picture."""

    @property
    def size(self) -> str:
        """For messages."""
        return f"{self.width_px}x{self.height_px} px"

    @property
    def bits(self) -> str:
        """For messages."""
        return f"{self.max_value.bit_length()}-bit"

    @property
    def stored_shape(self) -> tuple[int, ...]:
        """Height and width of the decoded array; a quarter turn swaps them."""
        size = (
            (self.width_px, self.height_px)
            if self.orientation >= 5
            else (self.height_px, self.width_px)
        )
        return size if self.grey else (*size, 3)

    @property
    def decoded_bytes(self) -> int:
        """Size of the decoded picture, with one or three samples per pixel."""
        return (
            self.width_px
            * self.height_px
            * (1 if self.grey else 3)
            * (2 if self.max_value > 255 else 1)
        )


def header_of(data: bytes | memoryview) -> Header | None:
    """The header of a picture in memory; None if its format is not supported."""
    return _header(io.BytesIO(data))


@lru_cache(maxsize=1)
def _add_heic() -> None:
    """Teaches Pillow to read HEIC, if the extra is there."""
    with contextlib.suppress(ImportError):
        from pillow_heif import register_heif_opener

        register_heif_opener(thumbnails=False)


def _eyes(image: Image.Image) -> tuple[int, ...]:
    """The frames of a spatial photo, left first: its group "ster" (ISO/IEC 23008-12)."""
    for group in image.info.get("entity_groups", ()):
        if group["type"] == "ster" and len(group["images"]) == 2 and None not in group["images"]:
            return tuple(group["images"])
    return ()


def _header(file: IO[bytes]) -> Header | None:
    if _HEIC.match(file.read(12)):
        _add_heic()
    file.seek(0)
    try:
        with Image.open(file, formats=FORMATS) as image:
            kind = "JPEG" if image.format == "MPO" else str(image.format)
            if image.mode == "F" or min(image.size) < 1:
                return None
            turn = 1
            with contextlib.suppress(Exception):  # damaged: the picture is shown as stored
                exif = Image.Exif()  # `image.getexif` would decode a PNG
                # OpenCV turns TIFF files
                exif.load(image.info.get("exif", b"") if kind != "TIFF" else b"")
                turn = int(exif.get(_ORIENTATION, 1))
            width, height = image.size[::-1] if 5 <= turn <= 8 else image.size
            return Header(
                format=kind,
                width_px=width,
                height_px=height,
                grey=image.mode in _GREY,
                max_value=_full_value(image),
                orientation=turn if 1 <= turn <= 8 else 1,
                frames=getattr(image, "n_frames", 1),
                eyes=_eyes(image),
                has_depth=bool(image.info.get("depth_images")),
            )
    except Exception:  # Pillow's parsers raise many kinds for damage
        return None


def _full_value(image: ImageFile.ImageFile) -> int:
    """The full-scale value of the stored samples, by what Pillow would decode them with."""
    codec, args = (image.tile[0].codec_name, image.tile[0].args) if image.tile else ("", "")
    if codec.startswith("ppm") and isinstance(args, tuple):  # (mode, full value)
        return max(255, int(args[1]))
    return 65535 if ";16" in str(args) or image.mode.startswith("I") else 255


def _unreadable(path: Path, why: str) -> UserError:
    return UserError(
        f"{path}: not a readable picture ({why})", "download it again, or export it as PNG or JPEG"
    )


def _checked(path: Path, file: IO[bytes]) -> Header:
    header = _header(file)
    if header is None:
        raise _unreadable(path, "truncated, damaged or another format")
    if header.decoded_bytes > MAX_DECODING_BYTES:
        raise UserError(
            f"{path}: too large: {header.size}, {header.decoded_bytes / 1e6:.0f} MB; at most"
            f" {MAX_DECODING_BYTES / 1e6:.0f} MB are read",
            "make it smaller",
        )
    if header.format == "HEIF" and header.frames > 1 and not header.eyes:
        raise UserError(
            f"{path}: a collection of {header.frames} pictures",
            f"export the one to show, or convert all: `heif-convert {path.name} {path.stem}.jpg`",
        )
    if header.format in _ENDS:
        size = os.fstat(file.fileno()).st_size
        file.seek(max(0, size - _TAIL))
        if _ENDS[header.format] not in file.read(_TAIL):
            raise _unreadable(path, f"truncated: a {header.format} file without its end")
    return header


def open_header(path: Path) -> Header:
    """The header of a picture.

    Raises UserError if it is no picture, too large to decode or certainly truncated.
    """
    with open_file(path) as file:
        return _checked(path, file)


def _frames(
    path: Path, file: IO[bytes], header: Header, count: int, mode: str
) -> list[NDArray[np.uint8]]:
    """The first frames by Pillow, as stored. mode: Pillow's, of the result. Raises UserError."""
    frames = []
    try:
        file.seek(0)
        with Image.open(file, formats=FORMATS) as image:
            for number in range(count):
                image.seek(number)
                frames.append(np.array(image.convert(mode)))
    except Exception:
        raise _unreadable(path, f"damaged after {len(frames)} of {header.frames} frames") from None
    return frames


def _imread(path: Path, file: IO[bytes], flags: int) -> NDArray[Any]:
    """The pixels as stored, by OpenCV. Raises UserError."""
    with contextlib.suppress(cv2.error):
        pixels = cv2.imread(proc_fd_path(file), flags | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is not None:
            return np.asarray(pixels)
    raise _unreadable(path, "truncated, damaged or not what its header claims")


def read_picture(path: Path) -> tuple[NDArray[Any], int]:
    """A picture's own values, upright, and the full value: ((h, w) or (h, w, 3) RGB, uint8 or
    uint16, max_value).

    Keeps the file's bit depth (a 10-bit PPM holds 0..1023; OpenCV's default would shift it to
    0..3). Drops an alpha plane; of an animation, gives the first frame. Raises UserError if the
    file is truncated, no picture or too large.
    """
    with open_file(path) as file:
        header = _checked(path, file)
        deep = header.max_value > 255
        if header.format in ("AVIF", "GIF", "HEIF"):
            pixels: NDArray[Any] = _frames(path, file, header, 1, "L" if header.grey else "RGB")[0]
        else:
            colours = cv2.IMREAD_GRAYSCALE if header.grey else cv2.IMREAD_COLOR
            pixels = _imread(path, file, colours | (cv2.IMREAD_ANYDEPTH if deep else 0))
            if pixels.shape != header.stored_shape or pixels.dtype != (
                np.uint16 if deep else np.uint8
            ):
                raise _unreadable(path, "damaged or not what its header claims")
            if not header.grey:  # OpenCV's IMREAD_COLOR_RGB does not convert 16-bit TIFF files
                cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB, dst=pixels)
    return upright(pixels, header.orientation), header.max_value


def read_frames(path: Path, most_bytes: int = MAX_DECODING_BYTES) -> list[NDArray[np.uint8]]:
    """All frames of an animation or all pictures of one file (GIF, WebP, MPO), uint8 (h, w, 3) RGB,
    upright. Raises UserError.
    """
    with open_file(path) as file:
        header = _checked(path, file)
        if header.frames * header.decoded_bytes > most_bytes:
            raise UserError(
                f"{path}: {header.frames} frames of {header.size} are too many to decode at once",
                "give its frames as pictures in a folder",
            )
        return [
            upright(frame, header.orientation)
            for frame in _frames(path, file, header, header.frames, "RGB")
        ]


def heic_depth(path: Path) -> NDArray[np.float32]:
    """The depth image of a HEIC picture that has one, float32 (h, w) 0 .. 1, white (1) is near.

    Raises UserError.
    """
    with open_file(path) as file:
        _checked(path, file)
        try:
            file.seek(0)
            with Image.open(file, formats=FORMATS) as image:
                depth = image.info["depth_images"][0]
                values = np.asarray(depth.to_pillow(), np.float32)
                is_distance = (depth.info["metadata"] or {}).get("representation_type") == 2
        except Exception:
            raise _unreadable(path, "its depth image is damaged") from None
    share = values / np.float32(65535 if values.max() > 255 else 255)
    return np.asarray(1 - share if is_distance else share, np.float32)


def small_grey(path: Path, most_px: float) -> NDArray[np.uint8]:
    """A picture in grey, uint8 (h, w); a JPEG much larger than most_px is decoded at 1/2, 1/4 or
    1/8 of its size, but not far below most_px. Raises UserError.
    """
    with open_file(path) as file:
        header = _checked(path, file)
        pixels = header.width_px * header.height_px
        reduced = [
            k for k in (2, 4, 8) if header.format == "JPEG" and pixels >= 0.75 * most_px * k * k
        ]
        if reduced:
            small = _imread(path, file, getattr(cv2, f"IMREAD_REDUCED_GRAYSCALE_{reduced[-1]}"))
            return np.asarray(upright(small, header.orientation), np.uint8)
    picture, full = read_picture(path)
    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    return np.asarray(
        grey if full == 255 else cv2.convertScaleAbs(grey, alpha=255 / full), np.uint8
    )


def upright(picture: NDArray[Any], orientation: int) -> NDArray[Any]:
    """A stored picture as EXIF's orientation (1 to 8) shows it; overwrites it unless that is a
    quarter turn.
    """
    if orientation >= 5:
        picture = np.asarray(cv2.transpose(picture))
    code = {2: 1, 3: -1, 4: 0, 6: 1, 7: -1, 8: 0}.get(orientation)
    return picture if code is None else np.asarray(cv2.flip(picture, code, dst=picture))
