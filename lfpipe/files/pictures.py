"""Picture files: headers by Pillow, pixels by OpenCV, which keeps 16 bits (AVIF, HEIC, animations
and transparency by Pillow). What a file says decides, not its ending.
"""

import contextlib
import io
import os
import re
import warnings
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, Literal

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, TiffImagePlugin

from lfpipe.errors import UserError
from lfpipe.files.picture_structure import MAX_PICTURES, BeyondLimitError, Structure, examine
from lfpipe.files.safe_files import open_file
from lfpipe.host.files import proc_fd_path

# 8192x8192 px of 8-bit colour, 7574x5264 px (lenslets of a Lytro Illum) of 16-bit colour
MAX_DECODING_BYTES = 240_000_000
_MAX_TURNED_BYTES = 2 * MAX_DECODING_BYTES  # which no TIFF of one picture exceeds
FORMATS = ("PNG", "JPEG", "PPM", "BMP", "TIFF", "WEBP", "AVIF", "GIF", "HEIF")
_HEIC = re.compile(rb"....ftyp(hei|hev|mif1|msf1)", re.DOTALL)
_GREY = ("1", "L", "I", "I;16", "I;16B", "I;16L")  # Pillow's modes of one sample per pixel
_ORIENTATION = 0x0112  # EXIF's tag
_MP_ENTRIES, _MP_NUMBER = 0xB002, 0xB101  # tags of a JPEG's index (CIPA DC-007)
_JPS = b"_JPSJPS_"  # begins the segment that describes a stereo JPEG
# Bytes that a decoder needs for a byte of the picture: OpenCV a second copy; Pillow its planes, 4
# bytes per pixel, and a copy (measured with AVIF: 3.9).
_COPIES, _PILLOW_COPIES = 2, 4
_BY_PILLOW = ("AVIF", "GIF", "HEIF")
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
_NEEDS_HEIC = "HEIC, which needs another package (the extra `heic`)"
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
    """The header of a picture in memory, whole or not; None if its format is not supported, or if
    it has more parts than are read.
    """
    file = io.BytesIO(data)
    with contextlib.suppress(BeyondLimitError):
        return _header(file, examine(file))
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
    found = stated or [at for at, kind in enumerate(kinds) if "Undefined" in kind or at == 0]
    sizes, numbers = {}, {}
    for at in found[:MAX_PICTURES]:
        if at:
            image.info.pop("mp", None)
            image.seek(at)
        sizes[at] = image.size
        numbers[at] = _individual_number(image.info.get("mp", b""))
    image.seek(0)
    largest = max(sizes.values())
    views = [at for at in found if sizes.get(at) == largest]
    if None not in numbers.values() and len(set(numbers.values())) == len(found):
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


def _beside(kind: str, frames: int, shown: int, after: bytes, after_bytes: int) -> str:
    """What else a file holds than the frames that are shown, for people; "" for nothing."""
    if frames > shown:
        what = {"JPEG": "picture", "HEIF": "picture", "TIFF": "page"}.get(kind, "frame")
        return f"{frames - shown} more {what}{'s' * (frames - shown > 1)}"
    if shown > 1 or not after.strip(b"\0"):  # padding
        return ""
    what = "other data"
    if after.startswith(b"\xff\xd8\xff"):
        what = "another picture"
    elif b"ftyp" in after or b"mpv" in after:
        what = "a video"
    return f"{what} behind the picture ({after_bytes / 1e6:.1f} MB)"


def _header(file: IO[bytes], structure: Structure) -> Header | None:
    file.seek(0)
    if _HEIC.match(file.read(12)):
        _add_heic()
    file.seek(0)
    try:
        with Image.open(file, formats=FORMATS) as image:
            kind = "JPEG" if image.format == "MPO" else str(image.format)
            if image.mode == "F" or min(image.size) < 1:
                return None
            turn = 1
            width, height = image.size
            if isinstance(image, TiffImagePlugin.TiffImageFile):
                turn = int(image.tag_v2.get(_ORIENTATION, 1))
                width, height = (int(image.tag_v2[tag]) for tag in (256, 257))
            else:
                with contextlib.suppress(Exception):  # damaged: the picture is shown as stored
                    exif = Image.Exif()  # `image.getexif` would decode a PNG
                    exif.load(image.info.get("exif", b""))
                    turn = int(exif.get(_ORIENTATION, 1))
            full = _full_value(image)
            segments = getattr(image, "applist", ())
            jps = next((data for _, data in segments if data.startswith(_JPS)), b"")
            counted = kind in ("TIFF", "GIF")  # which Pillow would count slowly
            frames = structure.pictures if counted else getattr(image, "n_frames", 1)
            alpha = image.mode.endswith(("A", "a")) or "transparency" in image.info
            eyes, sure = _eyes(image), True
            if image.format == "MPO":
                eyes, sure = _indexed_views(image)
            after = b""
            after_bytes = 0
            if structure.end is not None:
                after_bytes = file.seek(0, os.SEEK_END) - structure.end
                file.seek(structure.end)
                after = file.read(64)
            return Header(
                format=kind,
                width_px=height if 5 <= turn <= 8 else width,
                height_px=width if 5 <= turn <= 8 else height,
                grey=image.mode in _GREY and not alpha,
                max_value=full,
                orientation=turn if 1 <= turn <= 8 else 1,
                frames=frames,
                eyes=eyes,
                eyes_sure=sure,
                jps=int.from_bytes(jps[10:14]) if len(jps) >= 14 else None,
                alpha=alpha,
                has_depth=bool(image.info.get("depth_images")),
                beside=_beside(kind, frames, max(1, len(eyes) * sure), after, after_bytes),
            )
    except MemoryError:
        raise
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


def _failed(path: Path, header: Header, why: str) -> UserError:
    """The error of a decoder, which does not tell whether it had too little memory."""
    copies = _PILLOW_COPIES if header.format in _BY_PILLOW else _COPIES
    needed_bytes = copies * header.decoded_bytes
    try:
        np.empty(needed_bytes, np.uint8)
    except MemoryError:
        return UserError(
            f"{path}: decoding {header.size} of {header.format} needs more memory than is left here"
            f" ({needed_bytes / 1e6:.0f} MB)",
            "make it smaller",
        )
    return _unreadable(path, why)


def _kind_of(start: bytes) -> str:
    """What a file that is no supported picture is, by its first bytes."""
    if _HEIC.match(start) and not _add_heic():
        return _NEEDS_HEIC
    if start[4:8] == b"ftyp" and not (_HEIC.match(start) or start[8:11] == b"avi"):
        return "a video"
    names = (name for begin, name in _OTHERS.items() if start.lstrip().startswith(begin))
    return next(names, "")


def _checked(path: Path, file: IO[bytes]) -> tuple[Header, Structure]:
    try:
        structure = examine(file)
        header = _header(file, structure)
        if header is not None and header.frames > MAX_PICTURES:
            raise BeyondLimitError(f"{header.frames} frames; at most {MAX_PICTURES} are read")
    except BeyondLimitError as error:
        raise UserError(f"{path}: {error}", "export it again as PNG or JPEG") from None
    except MemoryError:
        raise UserError(
            f"{path}: its header needs more memory than is left here", "export it again as PNG"
        ) from None
    if header is None:
        file.seek(0)
        kind = _kind_of(file.read(32))
        raise _unreadable(path, f"it is {kind}" if kind else "truncated, damaged or another format")
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
    if not structure.whole:
        raise _unreadable(path, f"truncated: a {header.format} file without its end")
    return header, structure


def open_header(path: Path) -> Header:
    """The header of a picture.

    Raises UserError if it is no picture, too large to decode or certainly truncated.
    """
    with open_file(path) as file:
        about = os.fstat(file.fileno())
    return _known_header(path, about.st_ino, about.st_size, about.st_mtime_ns)


@lru_cache(maxsize=1 << 14)  # of one scene: layouts ask several times
def _known_header(path: Path, *_stamp: int) -> Header:
    with open_file(path) as file:
        return _checked(path, file)[0]


def _frames(
    path: Path, file: IO[bytes], header: Header, numbers: Iterable[int]
) -> list[NDArray[np.uint8]]:
    """Frames by Pillow, as stored; over grey where they are transparent. Raises UserError."""
    mode = "RGBA" if header.alpha else {True: "L", False: "RGB"}[header.grey]
    frames: list[NDArray[np.uint8]] = []
    try:
        file.seek(0)
        with Image.open(file, formats=FORMATS) as image:
            for number in numbers:
                image.seek(number)
                image.load()
                same = image.mode == mode
                frames.append(_opaque(np.array(image if same else image.convert(mode)), 255))
    except Exception:
        raise _failed(
            path, header, f"damaged after {len(frames)} of {header.frames} frames"
        ) from None
    return frames


def _opaque(pixels: NDArray[Any], full: int) -> NDArray[Any]:
    """Pixels with an alpha plane, shown over grey, a strip at a time; others as they are."""
    if pixels.ndim == 2 or pixels.shape[2] != 4:
        return pixels
    out = np.empty((*pixels.shape[:2], 3), pixels.dtype)
    for top in range(0, len(pixels), 64):
        strip = pixels[top : top + 64].astype(np.uint32)
        alpha = strip[..., 3:]
        out[top : top + 64] = (
            strip[..., :3] * alpha + (full + 1) // 2 * (full - alpha) + full // 2
        ) // full
    return out


def _as_stored(file: IO[bytes], header: Header, structure: Structure) -> IO[bytes]:
    """The file; of a turned TIFF a copy that says it is upright: decoders differ in which turns
    they apply, and refuse some.
    """
    if header.format != "TIFF" or header.orientation == 1 or structure.orientation_at is None:
        return file
    file.seek(0)
    copy = io.BytesIO(file.read(_MAX_TURNED_BYTES))
    order: Literal["little", "big"] = "little" if copy.read(2) == b"II" else "big"
    copy.seek(structure.orientation_at)
    copy.write((1).to_bytes(2, order))
    return copy


def _imread(path: Path, file: IO[bytes], header: Header, flags: int) -> NDArray[Any]:
    """The pixels as stored, by OpenCV. Raises UserError."""
    flags |= cv2.IMREAD_IGNORE_ORIENTATION if flags != cv2.IMREAD_UNCHANGED else 0
    with contextlib.suppress(cv2.error, MemoryError):
        if isinstance(file, io.BytesIO):
            pixels = cv2.imdecode(np.frombuffer(file.getbuffer(), np.uint8), flags)
        else:
            pixels = cv2.imread(proc_fd_path(file), flags)
        if pixels is not None:
            return np.asarray(pixels)
    raise _failed(path, header, "truncated, damaged or not what its header claims")


def read_picture(path: Path) -> tuple[NDArray[Any], int]:
    """A picture's own values, upright, and the full value: ((h, w) or (h, w, 3) RGB, uint8 or
    uint16, max_value).

    Keeps the file's bit depth (a 10-bit PPM holds 0..1023; OpenCV's default would shift it to
    0..3). Transparent parts are shown over grey; of an animation, the first frame. Raises UserError
    if the file is truncated, no picture or too large.
    """
    with open_file(path) as given:
        header, structure = _checked(path, given)
        file = _as_stored(given, header, structure)
        deep = header.max_value > 255
        if header.format in _BY_PILLOW or (header.alpha and not deep):
            pixels: NDArray[Any] = _frames(path, file, header, [0])[0]
        else:
            colours = cv2.IMREAD_GRAYSCALE if header.grey else cv2.IMREAD_COLOR
            flags = colours | (cv2.IMREAD_ANYDEPTH if deep else 0)
            flags = cv2.IMREAD_UNCHANGED if header.alpha else flags
            pixels = _opaque(_imread(path, file, header, flags), header.max_value)
            if pixels.shape != header.stored_shape or pixels.dtype != (
                np.uint16 if deep else np.uint8
            ):
                raise _unreadable(path, "damaged or not what its header claims")
            if not header.grey:  # OpenCV's IMREAD_COLOR_RGB does not convert 16-bit TIFF files
                cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB, dst=pixels)
    return upright(pixels, header.orientation), header.max_value


def read_frames(
    path: Path, numbers: Sequence[int] | None = None, most_bytes: int = MAX_DECODING_BYTES
) -> list[NDArray[np.uint8]]:
    """Frames of an animation or pictures of one file (GIF, WebP, MPO), or all of them, uint8
    (h, w, 3) RGB, upright. Raises UserError.
    """
    with open_file(path) as file:
        header, _ = _checked(path, file)
        header = attrs.evolve(header, grey=False)
        numbers = range(header.frames) if numbers is None else numbers
        if len(numbers) * header.decoded_bytes > most_bytes:
            raise UserError(
                f"{path}: {len(numbers)} frames of {header.size} are too many to decode at once",
                "give its frames as pictures in a folder",
            )
        return [
            upright(frame, header.orientation) for frame in _frames(path, file, header, numbers)
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
        header, _ = _checked(path, file)
        pixels = header.width_px * header.height_px
        reduced = [
            k for k in (2, 4, 8) if header.format == "JPEG" and pixels >= 0.75 * most_px * k * k
        ]
        if reduced:
            flags = getattr(cv2, f"IMREAD_REDUCED_GRAYSCALE_{reduced[-1]}")
            small = _imread(path, file, header, flags)
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
