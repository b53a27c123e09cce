"""Picture files, decoded by Pillow; 16 bits by OpenCV, because Pillow keeps eight. What a file says
decides, not its ending.
"""

import contextlib
import io
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, Literal

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, TiffImagePlugin
from PIL.ExifTags import Base

from lfpipe.errors import UserError
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import proc_fd_path

# 8192x8192 px of 8-bit colour, 7574x5264 px (lenslets of a Lytro Illum) of 16-bit colour
MAX_DECODING_BYTES = 240_000_000
MAX_PICTURES = 4096  # in one file: 64x64 views
FORMATS = ("JPEG", "PNG", "PPM", "BMP", "TIFF", "WEBP", "AVIF", "GIF", "HEIF")
_HEIC = re.compile(rb"....ftyp(hei|hev|mif1|msf1)", re.DOTALL)
_GREY = ("1", "L", "I", "I;16", "I;16B", "I;16L")  # Pillow's modes of one sample per pixel
_MP_ENTRIES, _MP_NUMBER = 0xB002, 0xB101  # tags of a JPEG's index (CIPA DC-007)
_JPS = b"_JPSJPS_"  # begins the segment that describes a stereo JPEG
STRIP_ROWS = 256  # of a picture, which are converted at a time: a second copy is spared
_OTHERS = {  # beginnings of other kinds of files, under the names of pictures
    b"\xff\x0a": "JPEG XL",
    b"\0\0\0\x0cJXL ": "JPEG XL",
    b"\0\0\0\x0cjP  ": "JPEG 2000",
    b"\xff\x4f\xff\x51": "JPEG 2000",
    b"8BPS": "Photoshop",
    b"v/1\x01": "OpenEXR",
    b"#?RADIANCE": "Radiance HDR",
    b"%PDF": "PDF",
    b"PK\x03\x04": "a ZIP archive",
    b"\x1f\x8b": "a gzip archive",
    b"<": "a web page or SVG",
}
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
    """Which frames are views, from the left eye's to the right; empty if unknown."""
    eyes_sure: bool = True
    """Whether the file says so; False: it has pictures of one size, of no stated kind."""
    jps: int | None = None
    """The descriptor of a stereo JPEG (`layouts.stereo`)."""
    alpha: bool = False
    """Parts may be transparent: they are shown over grey."""
    has_depth: bool = False
    """As a part of a HEIC picture."""
    beside: str = ""
    """What else the file holds, for notes."""

    @property
    def size(self) -> str:
        """For messages."""
        return f"{self.width_px}x{self.height_px} px"

    @property
    def bits(self) -> str:
        """For messages."""
        return f"{self.max_value.bit_length()}-bit"

    @property
    def holds_pair(self) -> bool:
        """Whether it says that it is a stereo pair."""
        return (bool(self.eyes) and self.eyes_sure) or (self.jps or 0) & 0xFF == 1

    @property
    def decoded_bytes(self) -> int:
        """Size of the decoded picture, with one or three samples per pixel."""
        samples = self.width_px * self.height_px * (1 if self.grey else 3)
        return samples * (2 if self.max_value > 255 else 1)


def header_of(data: bytes | memoryview) -> Header | None:
    """The header of a picture in memory, whole or not; None if it is not supported."""
    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as image:
            return _header(image)
    except Exception:  # Pillow's parsers raise many kinds for damage
        return None


@lru_cache(maxsize=1)
def _add_heic() -> bool:
    """Teaches Pillow to read HEIC; whether the extra is there."""
    try:
        from pillow_heif import register_heif_opener
    except ImportError:
        return False
    register_heif_opener(thumbnails=False)
    return True


def _eyes(image: Image.Image) -> tuple[int, ...]:
    """The frames of a spatial photo, left first: its group "ster" (ISO/IEC 23008-12)."""
    for group in image.info.get("entity_groups", ()):
        if group["type"] == "ster" and len(group["images"]) == 2 and None not in group["images"]:
            return tuple(group["images"])
    return ()


def _indexed_views(image: Any) -> tuple[tuple[int, ...], bool]:
    """The views among the pictures of a JPEG with an index, from the left, and whether it says that
    they are views: those of the kind "disparity", else two of one size and no other kind.
    """
    kinds = [entry["Attribute"]["MPType"] for entry in image.mpinfo[_MP_ENTRIES]]
    stated = [at for at, kind in enumerate(kinds) if "Disparity" in kind]
    candidates = stated or [at for at, kind in enumerate(kinds) if "Undefined" in kind or at == 0]
    sizes, numbers = {}, {}
    for at in candidates[:MAX_PICTURES]:
        if at:
            image.info.pop("mp", None)
            image.seek(at)
        sizes[at] = image.size
        numbers[at] = _individual_number(image.info.get("mp", b""))
    image.seek(0)
    largest = max(sizes.values())
    views = [at for at in candidates if sizes.get(at) == largest]
    if None not in numbers.values() and len(set(numbers.values())) == len(candidates):
        views.sort(key=lambda at: numbers[at] or 0)  # counted from the left
    sure = bool(stated)
    return (tuple(views), sure) if len(views) > 1 and (sure or len(views) == 2) else ((), False)


def _individual_number(index: bytes) -> int | None:
    """The number of a picture among its like, by its own part of the index; None if not stated."""
    file = io.BytesIO(index)
    with contextlib.suppress(Exception):  # damaged: the order of the index remains
        table = TiffImagePlugin.ImageFileDirectory_v2(file.read(8))
        for _ in range(2):  # the first picture has the index of all before its own part
            file.seek(table.next)
            table.load(file)
            if _MP_NUMBER in table:
                return int(table[_MP_NUMBER])
    return None


def _header(image: ImageFile.ImageFile) -> Header:
    """Raises exceptions of many kinds for damage."""
    kind = "JPEG" if image.format == "MPO" else str(image.format)
    if image.mode == "F" or min(image.size) < 1:
        raise ValueError("no samples that can be shown")
    turn = 1
    width, height = image.size
    if isinstance(image, TiffImagePlugin.TiffImageFile):
        turn = int(image.tag_v2.get(Base.Orientation, 1))
        width, height = (int(image.tag_v2[tag]) for tag in (256, 257))  # as stored
    else:
        with contextlib.suppress(Exception):  # damaged: the picture is shown as stored
            exif = Image.Exif()  # `image.getexif` would decode a PNG
            exif.load(image.info.get("exif", b""))
            turn = int(exif.get(Base.Orientation, 1))
    segments = getattr(image, "applist", ())
    jps = next((data for _, data in segments if data.startswith(_JPS)), b"")
    alpha = image.mode.endswith(("A", "a")) or "transparency" in image.info
    eyes, sure = _indexed_views(image) if image.format == "MPO" else (_eyes(image), True)
    frames = getattr(image, "n_frames", 1)
    more = frames - max(1, len(eyes) * sure)
    word = {"JPEG": "picture", "HEIF": "picture", "TIFF": "page"}.get(kind, "frame")
    return Header(
        format=kind,
        width_px=height if 5 <= turn <= 8 else width,
        height_px=width if 5 <= turn <= 8 else height,
        grey=image.mode in _GREY and not alpha,
        max_value=_full_value(image),
        orientation=turn if 1 <= turn <= 8 else 1,
        frames=frames,
        eyes=eyes,
        eyes_sure=sure,
        jps=int.from_bytes(jps[10:14]) if len(jps) >= 14 else None,
        alpha=alpha,
        has_depth=bool(image.info.get("depth_images")),
        beside=f"{more} more {word}{'s' * (more > 1)}" if more > 0 else "",
    )


def _full_value(image: ImageFile.ImageFile) -> int:
    """The full-scale value of the stored samples, by what Pillow would decode them with."""
    codec, args = (image.tile[0].codec_name, image.tile[0].args) if image.tile else ("", "")
    if codec.startswith("ppm") and isinstance(args, tuple):  # (mode, full value)
        return max(255, int(args[1]))
    return 65535 if ";16" in str(args) or image.mode.startswith("I") else 255


def _kind_of(start: bytes) -> str:
    """What a file that is no supported picture is, by its first bytes."""
    if _HEIC.match(start) and not _add_heic():
        return "HEIC, which needs another package (the extra `heic`)"
    if start[4:8] == b"ftyp" and not (_HEIC.match(start) or start[8:11] == b"avi"):
        return "a video"
    names = (name for begin, name in _OTHERS.items() if start.lstrip().startswith(begin))
    return next(names, "")


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[tuple[IO[bytes], ImageFile.ImageFile, Header]]:
    """A picture's file, image and header, which is small enough to decode; turns exceptions of
    decoders into UserError.
    """
    with open_file(path) as file:
        start = file.read(32)
        if _HEIC.match(start):
            _add_heic()
        file.seek(0)
        try:
            with Image.open(file, formats=FORMATS) as image:
                header = _header(image)
                _check(path, header)
                yield file, image, header
        except (UserError, MemoryError):
            raise
        except Exception:  # Pillow's parsers raise many kinds for damage
            other = _kind_of(start)
            why = f"it is {other}" if other else "truncated, damaged or another format"
            raise UserError(
                f"{path}: not a readable picture ({why})",
                "download it again, or export it as PNG or JPEG",
            ) from None


def _check(path: Path, header: Header) -> None:
    """Raises UserError if a picture is too large to decode, or several."""
    if header.frames > MAX_PICTURES:
        raise UserError(
            f"{path}: {header.frames} frames; at most {MAX_PICTURES} are read",
            "export it again as PNG or JPEG",
        )
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


def open_header(path: Path) -> Header:
    """The header of a picture. Raises UserError if it is no picture, or too large to decode."""
    with open_file(path) as file:
        about = os.fstat(file.fileno())
    return _cached_header(path, about.st_ino, about.st_size, about.st_mtime_ns)


@lru_cache(maxsize=1 << 14)  # of one scene: layouts ask several times
def _cached_header(path: Path, *_stamp: int) -> Header:
    with _opened(path) as (_, _, header):
        return header


def _pixels(image: ImageFile.ImageFile, header: Header) -> NDArray[np.uint8]:
    """The values of the frame on show, upright; over grey where they are transparent."""
    image.load()
    mode = "L" if header.grey else "RGB"
    if header.alpha:
        mode = "RGBA"
    size = image.height, image.width
    stored = np.empty(size if header.grey else (*size, 3), np.uint8)
    for top in range(0, image.height, STRIP_ROWS):
        bottom = min(top + STRIP_ROWS, image.height)
        strip = image.crop((0, top, image.width, bottom)).convert(mode)
        stored[top:bottom] = _opaque(np.asarray(strip), 255)
    # Pillow has turned a TIFF
    return upright(stored, 1 if header.format == "TIFF" else header.orientation)


def _opaque(pixels: NDArray[Any], full: int) -> NDArray[Any]:
    """Pixels with an alpha plane, shown over grey; others as they are."""
    if pixels.ndim == 2 or pixels.shape[2] != 4:
        return pixels
    colours, alpha = pixels[..., :3].astype(np.uint32), pixels[..., 3:].astype(np.uint32)
    over = (colours * alpha + (full + 1) // 2 * (full - alpha) + full // 2) // full
    return over.astype(pixels.dtype)


def _deep_pixels(file: IO[bytes], header: Header) -> NDArray[np.uint16]:
    """As `_pixels`, of two bytes each. Raises ValueError for damage."""
    np.empty(2 * header.decoded_bytes, np.uint8)  # OpenCV does not tell that memory is short
    flags = cv2.IMREAD_GRAYSCALE if header.grey else cv2.IMREAD_COLOR
    flags |= cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    flags = cv2.IMREAD_UNCHANGED if header.alpha else flags
    if header.format == "TIFF" and header.orientation > 1:
        read = cv2.imdecode(np.frombuffer(_as_stored(file, header.orientation), np.uint8), flags)
    else:
        read = cv2.imread(proc_fd_path(file), flags)
    turned = header.orientation >= 5
    size = header.height_px, header.width_px
    if read is None or read.shape[:2] != size[:: -1 if turned else 1] or read.dtype != np.uint16:
        raise ValueError("damaged, or not what its header claims")
    strips = np.array_split(np.asarray(read), -(-len(read) // STRIP_ROWS))
    pixels = np.concatenate([_opaque(strip, 65535) for strip in strips]) if header.alpha else read
    if not header.grey:  # OpenCV's IMREAD_COLOR_RGB does not convert 16-bit TIFF files
        cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB, dst=pixels)
    return upright(pixels, header.orientation)


def _as_stored(file: IO[bytes], turn: int) -> bytes:
    """A TIFF that says it is upright: OpenCV applies some turns and refuses others."""
    file.seek(0)
    data = file.read(2 * MAX_DECODING_BYTES)  # which no TIFF of one picture exceeds
    order: Literal["little", "big"] = "little" if data.startswith(b"II") else "big"
    tag = b"".join(
        number.to_bytes(2, order) for number in (Base.Orientation, 3)
    )  # 3: two bytes each
    tag += (1).to_bytes(4, order)
    return data.replace(tag + turn.to_bytes(2, order), tag + (1).to_bytes(2, order), 1)


def read_picture(path: Path) -> tuple[NDArray[Any], int]:
    """A picture's own values, upright, and the full value: ((h, w) or (h, w, 3) RGB, uint8 or
    uint16, max_value).

    Keeps the file's bit depth (a 10-bit PPM holds 0..1023). Transparent parts are shown over grey;
    of an animation, the first frame. Raises UserError if the file is truncated, no picture or too
    large.
    """
    with _opened(path) as (file, image, header):
        deep = header.max_value > 255
        return _deep_pixels(file, header) if deep else _pixels(image, header), header.max_value
    raise AssertionError


def read_frames(
    path: Path, numbers: Sequence[int] | None = None, most_bytes: int = MAX_DECODING_BYTES
) -> list[NDArray[np.uint8]]:
    """Frames of an animation or pictures of one file (GIF, WebP, MPO), or all of them, uint8
    (h, w, 3) RGB, upright. Raises UserError.
    """
    frames: list[NDArray[np.uint8]] = []
    with _opened(path) as (_, image, header):
        header = attrs.evolve(header, grey=False)
        numbers = range(header.frames) if numbers is None else numbers
        if len(numbers) * header.decoded_bytes > most_bytes:
            raise UserError(
                f"{path}: {len(numbers)} frames of {header.size} are too many to decode at once",
                "give its frames as pictures in a folder",
            )
        for number in numbers:
            image.seek(number)
            frames.append(_pixels(image, header))
    return frames


def heic_depth(path: Path) -> NDArray[np.float32]:
    """The depth image of a HEIC picture that has one, float32 (h, w) 0 .. 1, white (1) is near.

    Raises UserError.
    """
    with _opened(path) as (_, image, _):
        depth = image.info["depth_images"][0]
        values = np.asarray(depth.to_pillow(), np.float32)
        is_distance = (depth.info["metadata"] or {}).get("representation_type") == 2
        share = values / np.float32(65535 if values.max() > 255 else 255)
        return np.asarray(1 - share if is_distance else share, np.float32)
    raise AssertionError


def small_grey(path: Path, most_px: float) -> NDArray[np.uint8]:
    """A picture in grey, uint8 (h, w); a JPEG much larger than most_px is decoded at 1/2, 1/4 or
    1/8 of its size, but not far below most_px. Raises UserError.
    """
    with _opened(path) as (_, image, header):
        pixels = header.width_px * header.height_px
        reduced = [k for k in (2, 4, 8) if pixels >= 0.75 * most_px * k * k]
        if header.format == "JPEG" and reduced:
            image.draft("L", (image.width // reduced[-1], image.height // reduced[-1]))
            return _pixels(image, attrs.evolve(header, grey=True))
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
