"""Reads the header of an encoded picture before a decoder allocates memory.

The program decodes only these formats: PNG, JPEG, BMP, PNM, TIFF and WebP. This parser may be stricter than the decoder, but not
looser: anything it does not understand is refused.
"""

import contextlib
import re
import struct
from collections.abc import Callable

import attrs

MAX_DECODING_BYTES = 240_000_000  # 8192x8192 px of 8-bit colour, 7574x5264 px (lenslets of a Lytro Illum) of 16-bit colour
Read = Callable[[int, int], bytes]  # (offset, count) -> bytes, fewer at the end of the file

_MAX_BESIDE_BYTES = 64 << 20  # of everything else in the file: profiles, thumbnails
_MAX_SEGMENTS = 1000  # of a JPEG before its picture; also entries of a TIFF directory
_MAX_SCANS = 100  # of a JPEG; encoders write about 10
_MAX_CHUNKS, _MAX_OTHER_CHUNKS = 100_000, 500  # of a PNG; chunks other than picture data can print warnings
_DEFLATE_RATIO = 1040  # deflate packs at most 1032 bytes into one
_GAP = rb"\s+(?:#[^\r\n]*[\r\n]\s*)*"
_PNM = re.compile(rb"P([1-6])" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})(?:" + _GAP + rb"(\d{1,9}))?\s")


@attrs.frozen
class Header:
    """The claims of a picture's header. width_px, height_px: upright. grey: one sample per pixel, neither colour nor alpha.
    max_value: the full-scale value, above 255 for samples of two bytes. extra_bytes: measured maximum of the decoder's memory
    besides the picture it returns. least_bytes: minimum size of a whole file of this format and size. orientation: of the stored
    picture, 1 (upright) to 8, as EXIF counts."""

    format: str
    width_px: int
    height_px: int
    grey: bool = False
    max_value: int = 255
    extra_bytes: int = 0
    least_bytes: int = 0
    orientation: int = 1

    @property
    def stored_px(self) -> tuple[int, int]:
        """Height and width of the stored picture; a quarter turn exchanges them."""
        return (self.width_px, self.height_px) if self.orientation >= 5 else (self.height_px, self.width_px)

    @property
    def decoded_bytes(self) -> int:
        """Size of the decoded picture, with one or three samples per pixel."""
        return self.width_px * self.height_px * (1 if self.grey else 3) * (2 if self.max_value > 255 else 1)

    def problem(self, file_bytes: int) -> str:
        """The reason for not decoding a file of file_bytes with this header, or ""."""
        claim = f"a {self.format} file that claims {self.width_px}x{self.height_px} px"
        if self.width_px < 1 or self.height_px < 1:
            return claim
        need = self.decoded_bytes + self.extra_bytes + (file_bytes if self.format == "TIFF" else 0)  # the file is mapped
        if need > MAX_DECODING_BYTES:
            return f"{claim}: decoding needs {need / 1e6:.0f} MB; at most {MAX_DECODING_BYTES / 1e6:.0f} MB are allowed"
        most = 8 * self.decoded_bytes + _MAX_BESIDE_BYTES
        if file_bytes > most:
            return f"{claim} has at most {most} bytes; this one has {file_bytes}"
        if file_bytes < self.least_bytes:
            return f"truncated: {claim} has at least {self.least_bytes} bytes; this one has {file_bytes}"
        return ""


def read_header(read: Read) -> Header | None:
    """The header of the picture behind `read`; None if its format is not supported."""
    start = read(0, 4096)
    for sign, parse in _PARSERS:
        if start.startswith(sign):
            try:
                return parse(start, read)
            except (struct.error, IndexError):  # the file ends within the header
                return None
    return None


def header_of(data: bytes | memoryview) -> Header | None:
    """`read_header` of a picture in memory."""
    return read_header(lambda offset, count: bytes(data[offset : offset + count]))


def _png(start: bytes, read: Read) -> Header | None:
    size, kind, width, height, depth, colour = struct.unpack_from(">I4sIIBB", start, 8)
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour)
    if (size, kind) != (13, b"IHDR") or samples is None or depth not in (1, 2, 4, 8, 16):
        return None
    if not _png_is_whole(read):
        return None
    raw = height * (1 + (width * samples * depth + 7) // 8)
    return Header("PNG", width, height, colour == 0, 65535 if depth == 16 else 255, 0, raw // _DEFLATE_RATIO)


def _png_is_whole(read: Read) -> bool:
    """Whether all chunks lie within the file. OpenCV allocates what a chunk claims, and fills it."""
    at, others = 8, 0
    for _ in range(_MAX_CHUNKS):
        size, kind = struct.unpack(">I4s", read(at, 8))
        at, others = at + 12 + size, others + (kind != b"IDAT")
        if len(read(at - 4, 4)) < 4 or others > _MAX_OTHER_CHUNKS:
            return False
        if kind == b"IEND":
            return True
    return False


def _jpeg(_: bytes, read: Read) -> Header | None:
    """Finds the frame header and the first scan: the decoder of a multi-scan picture stores all coefficients, 2 bytes each."""
    at, frame, orientation = 2, b"", 0
    for _segment in range(_MAX_SEGMENTS):
        part = read(at, 64)
        while part[:2] == b"\xff\xff":  # fill bytes
            at, part = at + 1, part[1:] or read(at + 1, 64)
        marker, size = struct.unpack_from(">xBH", part)
        if part[0] != 0xFF or size < 2:
            return None
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            if frame:
                return None
            frame = part[1:2] + read(at + 4, size - 2)
        if marker == 0xE1 and not orientation:
            orientation = _exif_orientation(read(at + 4, size - 2))
        if marker == 0xDA:
            header = _jpeg_frame(frame, part[4]) if frame else None
            if header is None or (header.extra_bytes and _scans(read, at) > _MAX_SCANS):
                return None
            return _turned(header, orientation) if orientation > 1 else header
        at += 2 + size
    return None


def _exif_orientation(segment: bytes) -> int:
    """The orientation, 1 to 8, in a segment of a JPEG (CIPA DC-008, tag 0x0112 of the first directory); 0 if there is none."""
    order = {b"II": "<", b"MM": ">"}.get(segment[6:8])
    if segment[:6] != b"Exif\0\0" or order is None:
        return 0
    with contextlib.suppress(struct.error):  # damaged: the picture is shown as stored
        at = 6 + int(struct.unpack_from(order + "I", segment, 10)[0])
        for number in range(struct.unpack_from(order + "H", segment, at)[0]):
            tag, kind, _, value = struct.unpack_from(order + "HHIH", segment, at + 2 + 12 * number)
            if tag == 0x0112:
                return int(value) if kind == 3 and 1 <= value <= 8 else 0
    return 0


def _turned(header: Header, orientation: int) -> Header:
    """Header of a picture that is turned after decoding; a quarter turn needs memory for both."""
    if orientation < 5:
        return attrs.evolve(header, orientation=orientation)
    width, height, extra = header.height_px, header.width_px, header.extra_bytes + header.decoded_bytes
    return attrs.evolve(header, width_px=width, height_px=height, extra_bytes=extra, orientation=orientation)


def _scans(read: Read, at: int) -> int:
    """Upper bound of a JPEG's scans. Each scan costs the time of a whole picture, and a short file can have thousands."""
    scans, last = 0, b""
    while data := read(at, 1 << 20):
        scans += (last + data).count(b"\xff\xda")
        at, last = at + len(data), data[-1:]
    return scans


def _jpeg_frame(frame: bytes, scanned: int) -> Header | None:
    marker, precision, height, width, count = struct.unpack_from(">BBHHB", frame)
    factors = [(frame[8 + 3 * k] >> 4, frame[8 + 3 * k] & 15) for k in range(count)]
    if precision != 8 or count not in (1, 3, 4) or not all(1 <= h <= 4 and 1 <= v <= 4 for h, v in factors):
        return None
    across, down = max(h for h, _ in factors), max(v for _, v in factors)
    units = -(-width // (8 * across)) * -(-height // (8 * down))
    blocks = units * sum(h * v for h, v in factors)
    progressive, arithmetic = marker in (0xC2, 0xC6, 0xCA, 0xCE), marker >= 0xC9
    kept = 128 * blocks if progressive or scanned < count else 0
    least = 0 if arithmetic else blocks // 8  # Huffman codes need at least one bit per block
    return Header("JPEG", width, height, count == 1, 255, kept, least)


def _bmp(start: bytes, _: Read) -> Header | None:
    (size,) = struct.unpack_from("<I", start, 14)
    if size == 12:
        width, height, planes, bits = struct.unpack_from("<HHHH", start, 18)
        packing = 0
    elif 36 <= size <= 256:
        width, height, planes, bits, packing = struct.unpack_from("<iiHHI", start, 18)
    else:
        return None
    if planes != 1 or bits not in (1, 4, 8, 16, 24, 32) or packing not in (0, 1, 2, 3):
        return None
    height = abs(height)
    row = (width * bits + 31) // 32 * 4
    return Header("BMP", width, height, False, 255, 3 * width * height + row, height * row if packing in (0, 3) else 0)


def _pnm(start: bytes, _: Read) -> Header | None:
    found = _PNM.match(start)
    if not found:
        return None
    kind, width, height = int(found[1]), int(found[2]), int(found[3])
    full = 1 if kind in (1, 4) else int(found[4] or 0)
    if not 1 <= full <= 65535:
        return None
    header = Header("PNM", width, height, kind not in (3, 6), full if full > 1 else 255)
    samples = width * height * (1 if header.grey else 3)
    least = {1: samples, 2: samples, 3: samples, 4: height * ((width + 7) // 8)}.get(kind, header.decoded_bytes)
    return attrs.evolve(header, least_bytes=least)


_TIFF_SIZES = {1: (1, "B"), 3: (2, "H"), 4: (4, "I"), 16: (8, "Q")}
_WIDTH, _HEIGHT, _BITS, _PACKING, _COLOUR, _SAMPLES = 256, 257, 258, 259, 262, 277
_STRIP_ROWS, _TILE_WIDTH, _TILE_HEIGHT = 278, 322, 323
_TAGS = {_WIDTH, _HEIGHT, _BITS, _PACKING, _COLOUR, _SAMPLES, _STRIP_ROWS, _TILE_WIDTH, _TILE_HEIGHT}


def _tiff(start: bytes, read: Read) -> Header | None:
    """The first directory; strips and tiles are buffered whole by the decoder."""
    order = "<" if start[:2] == b"II" else ">"
    (version,) = struct.unpack_from(order + "H", start, 2)
    if version == 42:
        (at,), head, entry = struct.unpack_from(order + "I", start, 4), "H", "HHI4s"
    elif version == 43 and start[4:8] == struct.pack(order + "HH", 8, 0):
        (at,), head, entry = struct.unpack_from(order + "Q", start, 8), "Q", "HHQ8s"
    else:
        return None
    head_size, entry_size = struct.calcsize(order + head), struct.calcsize(order + entry)
    (count,) = struct.unpack(order + head, read(at, head_size))
    if not 1 <= count <= _MAX_SEGMENTS:
        return None
    table = read(at + head_size, count * entry_size)
    tags: dict[int, int] = {}
    for number in range(count):
        tag, kind, length, value = struct.unpack_from(order + entry, table, number * entry_size)
        if tag in _TAGS:
            size, code = _TIFF_SIZES.get(kind, (0, ""))
            if tag in tags or not size or not 1 <= length <= 4:
                return None
            if size * length > len(value):  # the values are stored elsewhere
                (there,) = struct.unpack(order + ("I" if len(value) == 4 else "Q"), value)
                value = read(there, size * length)
            tags[tag] = max(struct.unpack_from(f"{order}{length}{code}", value))
    width, height, bits = tags.get(_WIDTH, 0), tags.get(_HEIGHT, 0), tags.get(_BITS, 1)
    samples = tags.get(_SAMPLES, 1)
    if bits not in (1, 2, 4, 8, 10, 12, 14, 16) or not 1 <= samples <= 4:
        return None
    rows = min(tags.get(_STRIP_ROWS, height), height)
    piece = tags[_TILE_WIDTH] * tags[_TILE_HEIGHT] if _TILE_WIDTH in tags and _TILE_HEIGHT in tags else rows * width
    grey, full = samples == 1 and tags.get(_COLOUR) in (0, 1), 65535 if bits > 8 else 255
    extra = 2 * piece * max(samples, 4) * (2 if bits > 8 else 1)
    least = height * ((width * samples * bits + 7) // 8) if tags.get(_PACKING, 1) == 1 else 0
    return Header("TIFF", width, height, grey, full, extra, least)


def _webp(start: bytes, _: Read) -> Header | None:
    if start[8:12] != b"WEBP":
        return None
    kind, body = start[12:16], start[20:]
    if kind == b"VP8 " and body[3:6] == b"\x9d\x01\x2a":
        width, height = (n & 0x3FFF for n in struct.unpack_from("<HH", body, 6))
    elif kind == b"VP8L" and body[:1] == b"\x2f":
        (packed,) = struct.unpack_from("<I", body, 1)
        width, height = 1 + (packed & 0x3FFF), 1 + (packed >> 14 & 0x3FFF)
    elif kind == b"VP8X" and not body[0] & 2:  # not an animation
        width, height = (1 + int.from_bytes(body[k : k + 3], "little") for k in (4, 7))
    else:
        return None
    (size,) = struct.unpack_from("<I", start, 4)
    return Header("WebP", width, height, False, 255, 32 * width if kind == b"VP8 " else 5 * width * height, size)


_PARSERS: tuple[tuple[bytes, Callable[[bytes, Read], Header | None]], ...] = (
    (b"\x89PNG\r\n\x1a\n", _png),
    (b"\xff\xd8\xff", _jpeg),
    (b"BM", _bmp),
    (b"II", _tiff),
    (b"MM", _tiff),
    (b"RIFF", _webp),
    (b"P", _pnm),
)
