"""The structure of picture files, read before any decoder sees them: whether a picture is whole,
whatever follows it, and how much work it claims. Decoders take as long as a file wants.

JPEG: ITU T.81, annex B; PNG: W3C; GIF89a; TIFF 6.0 and BigTIFF; WebP: RFC 9649; AVIF and HEIF:
ISO/IEC 14496-12 (boxes).
"""

import contextlib
import re
import struct
from pathlib import Path
from typing import IO, Any

import attrs

from lfpipe.files.safe_files import open_regular

# Each scan is one more pass over the whole picture, for a dozen bytes; encoders use some ten.
MAX_SCANS = 100
MAX_PICTURES = 4096  # in one file: 64x64 views
MAX_PARTS = 1 << 17  # chunks or segments: of a PNG, 8 kB each, of the largest picture; a second
_WINDOW = 1 << 20
_BOXES = (b"ftyp", b"meta", b"mdat", b"moov", b"free", b"skip", b"uuid", b"mpvd")
_MAX_SCAN_BYTES = 1 << 29  # twice the largest decoded picture
_JPEG_MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")  # none of fill, stuffed zeros or restarts
# the heads of other files; of a JPEG in group 1, because one may be part of a picture's metadata
_HEAD = (
    rb"(\xff\xd8\xff[\xdb-\xef])|\x89PNG\r\n\x1a\n|GIF8[79]a|RIFF....(?:WEBP|AVI )"
    rb"|\0\0..ftyp[\w ]{4}"
)
_HEAD_BYTES = 16
_PNM = re.compile(rb"P([56])\s+(?:#.*\s+)*(\d+)\s+(?:#.*\s+)*(\d+)\s+(?:#.*\s+)*(\d+)\s")
_TIFF_ORIENTATION = 0x0112
_TIFF_PIXELS = ((273, 279), (324, 325))  # offsets and lengths of strips, of tiles
_TIFF_NUMBERS = {3: "H", 4: "I", 16: "Q"}
_TIFF_BYTES = (0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8)  # of a value, by type
_MANY_PARTS = f"more than {MAX_PARTS} parts; at most {MAX_PARTS} are read"


class BeyondLimitError(ValueError):
    """A picture that claims more parts than are read."""


def begins_as_picture(path: Path) -> bool:
    """Whether a file begins like a picture whose format no other kind of file shares (raw pictures
    of cameras begin like TIFF)."""
    with contextlib.suppress(OSError), open_regular(path) as file:
        start = file.read(12)
        webp = start.startswith(b"RIFF") and start.endswith(b"WEBP")
        avif = start[4:] in (b"ftypavif", b"ftypavis")
        return webp or avif or start.startswith((b"\xff\xd8\xff", b"\x89PNG\r\n", b"GIF8"))
    return False


class _CutError(ValueError):
    """A part lies behind the end of the file."""


@attrs.frozen(kw_only=True)
class Structure:
    """What a file says of its picture, as far as decoders do not check it themselves."""

    whole: bool = True
    end: int | None = None
    """The first byte behind the picture; None if its format does not tell."""
    pictures: int = 1
    orientation_at: int | None = None
    """Where a TIFF file says its orientation, in two bytes."""


def examine(file: IO[bytes]) -> Structure:
    """The structure of the picture in file.

    Raises BeyondLimitError if it has more parts than are read.
    """
    file.seek(0)
    start = file.read(16)
    try:
        if start.startswith(b"\xff\xd8\xff"):
            return Structure(end=_jpeg_end(file))
        if start.startswith(b"\x89PNG"):
            return Structure(end=_png_end(file))
        if start.startswith((b"II*\0", b"II+\0", b"MM\0*", b"MM\0+")):
            return _tiff(file, start)
        if start.startswith(b"GIF8"):
            return Structure(pictures=_gif_pictures(file))
        if start[4:8] == b"ftyp":
            return Structure(end=_checked_end(file, start, _boxes_end(file)))
        if start.startswith(b"RIFF") and start[8:12] == b"WEBP":
            length = int.from_bytes(start[4:8], "little")
            return Structure(end=_checked_end(file, start, 8 + length + length % 2))
        if start.startswith(b"BM") and (length := int.from_bytes(start[2:6], "little")):
            return Structure(end=_checked_end(file, start, length))
        if head := _PNM.match(start + file.read(200)):
            kind, width, height, full = map(int, head.groups())
            length = width * height * (3 if kind == 6 else 1) * (2 if full > 255 else 1)
            return Structure(end=_checked_end(file, start, head.end() + length))
    except _CutError:
        return Structure(whole=False)
    return Structure()


def _read(file: IO[bytes], at: int, count: int) -> bytes:
    file.seek(at)
    data = file.read(count)
    if len(data) < count:
        raise _CutError
    return data


def _numbers(file: IO[bytes], at: int, form: str) -> tuple[Any, ...]:
    return struct.unpack(form, _read(file, at, struct.calcsize(form)))


def _limited(count: int, most: int, what: str) -> None:
    if count > most:
        raise BeyondLimitError(f"more than {most} {what}; at most {most} are read")


def _checked_end(file: IO[bytes], start: bytes, end: int) -> int | None:
    """The end that a picture states, None if it lies behind that of the file: its decoder knows
    whether it needs that. Raises _CutError if another file begins before and ends behind it.
    """
    size = file.seek(0, 2)
    if size < end:
        return None
    head = re.compile(re.escape(start[:12]) + b"|" + _HEAD, re.DOTALL)
    for at in range(_HEAD_BYTES, end if size > end else 0, _WINDOW):
        file.seek(at)
        for found in head.finditer(file.read(_WINDOW + _HEAD_BYTES)):
            begin = at + found.start()
            if begin < end and (found[1] is None or _ends_behind(file, begin, end)):
                raise _CutError
    return end


def _ends_behind(file: IO[bytes], begin: int, end: int) -> bool:
    """Whether a JPEG begins there, and ends behind a place."""
    try:
        return _jpeg_end(file, begin) > end
    except (_CutError, BeyondLimitError):
        return False


def _jpeg_end(file: IO[bytes], begin: int = 0) -> int:
    at = begin + 2
    scans = 0
    for _ in range(MAX_PARTS):
        marker, at = _next_marker(file, at, coded=scans > 0)
        if marker == 0xD9 and scans:
            return at
        if marker in (0xD8, 0xD9):  # another picture begins or ends within this one
            raise _CutError
        scans += marker == 0xDA
        _limited(scans, MAX_SCANS, "scans")
        if marker != 0x01:
            at += _numbers(file, at, ">H")[0]
    raise BeyondLimitError(_MANY_PARTS)


def _next_marker(file: IO[bytes], at: int, coded: bool) -> tuple[int, int]:
    """The code of the next marker of a JPEG, and where it ends. coded: it may follow coded data;
    otherwise only padding.
    """
    last = at + _MAX_SCAN_BYTES
    size = 64  # between segments, it is there
    while at < last:
        file.seek(at)
        window = file.read(size)
        if found := _JPEG_MARKER.search(window):
            if not coded and window[: found.start()].strip(b"\0\xff"):
                break
            return window[found.start() + 1], at + found.end()
        if len(window) < size:
            break
        at += size - 1  # its first byte may be the last one here
        size = _WINDOW
    raise _CutError


def _png_end(file: IO[bytes]) -> int:
    at = 8
    for _ in range(MAX_PARTS):
        length, kind = _numbers(file, at, ">I4s")
        at += 12 + int(length)
        if kind == b"IEND":
            _read(file, at - 4, 4)
            return at
    raise BeyondLimitError(_MANY_PARTS)


def _tiff(file: IO[bytes], start: bytes) -> Structure:
    order = "<" if start.startswith(b"I") else ">"
    big = b"+" in start[2:4]
    count_form, entry_form, next_form = ("Q", "HHQ8s", "Q") if big else ("H", "HHI4s", "I")
    at = _numbers(file, 8 if big else 4, order + next_form)[0]
    size = file.seek(0, 2)
    count = _numbers(file, at, order + count_form)[0]
    entry_bytes = struct.calcsize(order + entry_form)
    first = at + struct.calcsize(order + count_form)
    _limited(count, MAX_PICTURES, "tags")
    entries = list(struct.iter_unpack(order + entry_form, _read(file, first, count * entry_bytes)))
    values = sum(
        _TIFF_BYTES[kind] * number for _, kind, number, _ in entries if kind < len(_TIFF_BYTES)
    )
    _limited(values, size, "bytes in tags")  # each would be read on its own
    turn = next((k for k, entry in enumerate(entries) if entry[0] == _TIFF_ORIENTATION), None)
    _checked_end(file, start, _tiff_end(file, order, entries))
    pictures = 0
    while at:
        pictures += 1
        _limited(pictures, MAX_PICTURES, "pictures in one file")
        try:
            count = _numbers(file, at, order + count_form)[0]
            after = at + struct.calcsize(order + count_form) + count * entry_bytes
            at = _numbers(file, after, order + next_form)[0]
        except _CutError:  # of the pictures behind the first, which alone is shown
            break
    value = first + entry_bytes - (8 if big else 4)
    return Structure(
        pictures=pictures, orientation_at=None if turn is None else value + turn * entry_bytes
    )


def _tiff_end(file: IO[bytes], order: str, entries: list[tuple[Any, ...]]) -> int:
    """Where the pixels of a TIFF's first picture end; 0 if unknown."""
    values: dict[int, tuple[int, ...]] = {}
    for tag, kind, number, raw in entries:
        if any(tag in pair for pair in _TIFF_PIXELS) and kind in _TIFF_NUMBERS:
            length = _TIFF_BYTES[kind] * number
            at = struct.unpack(f"{order}{'IQ'[len(raw) // 8]}", raw)[0]
            data = raw[:length] if length <= len(raw) else _read(file, at, length)
            values[tag] = struct.unpack(f"{order}{number}{_TIFF_NUMBERS[kind]}", data)
    ends = (
        at + length
        for place, count in _TIFF_PIXELS
        for at, length in zip(values.get(place, ()), values.get(count, ()), strict=False)
    )
    return max(ends, default=0)


def _gif_pictures(file: IO[bytes]) -> int:
    """The number of its frames; a cut one ends with the last that begins."""

    def table_bytes(flags: int) -> int:
        return 3 << ((flags & 7) + 1) if flags & 0x80 else 0

    pictures = 0
    try:
        at = 13 + table_bytes(_read(file, 10, 1)[0])
        while (kind := _read(file, at, 1)[0]) in (0x21, 0x2C):
            if kind == 0x2C:
                pictures += 1
                _limited(pictures, MAX_PICTURES, "frames")
                at += 11 + table_bytes(_read(file, at + 9, 1)[0])
            else:
                at += 2
            while length := _read(file, at, 1)[0]:
                at += 1 + length
            at += 1
    except _CutError:  # its decoder says so
        pass
    return max(1, pictures)


def _boxes_end(file: IO[bytes]) -> int:
    """The end that the last box states, before another file or none."""
    at = 0
    with contextlib.suppress(_CutError):
        for _ in range(MAX_PICTURES):
            length, kind = _numbers(file, at, ">I4s")
            if kind not in _BOXES or (at and kind == b"ftyp"):
                break
            if length == 0:  # to the end of the file
                return file.seek(0, 2)
            if length == 1:
                length = _numbers(file, at + 8, ">Q")[0]
            at += max(length, 8)
    return at
