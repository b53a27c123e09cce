"""Pictures and maps in every format whose heads claim a size that their bytes do not hold."""

import random
import struct
import zlib

SIZES = (0, 1, 24, 20_000, 32_767, 65_535, 65_536, 1_000_000, 2**31 - 1, 2**31, 2**32 - 1)


def _png(w: int, h: int, rng: random.Random) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(
        ">IIBBBBB", w & 0xFFFFFFFF, h & 0xFFFFFFFF, rng.choice((1, 8, 16)), rng.choice((0, 2, 3, 4, 6)), 0, 0, rng.choice((0, 1))
    )
    body = zlib.compress(bytes(rng.choice((100, 2_000_000))), 9)
    extra = chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(5_000_000), 9)) if rng.random() < 0.3 else b""
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + extra
        + chunk(b"IDAT", body)
        + (chunk(b"IEND", b"") if rng.random() < 0.8 else b"")
    )


def _jpeg(w: int, h: int, rng: random.Random) -> bytes:
    planes = rng.choice((1, 3))
    parts = b"".join(struct.pack("BBB", n + 1, rng.choice((0x11, 0x22, 0x44)), 0) for n in range(planes))
    frame = struct.pack(">BHHB", 8, h & 0xFFFF, w & 0xFFFF, planes) + parts
    mark = rng.choice((b"\xff\xc0", b"\xff\xc2"))
    table = b"\xff\xdb" + struct.pack(">H", 67) + b"\0" + b"\1" * 64
    scan = (
        b"\xff\xda"
        + struct.pack(">HB", 6 + 2 * planes, planes)
        + b"".join(struct.pack("BB", n + 1, 0) for n in range(planes))
        + b"\0\x3f\0"
    )
    return (
        b"\xff\xd8"
        + table
        + mark
        + struct.pack(">H", len(frame) + 2)
        + frame
        + (scan * rng.choice((1, 500)))
        + bytes(200)
        + b"\xff\xd9"
    )


def _pnm(w: int, h: int, rng: random.Random) -> bytes:
    kind = rng.choice("1234567")
    full = rng.choice((0, 1, 255, 256, 1023, 65_535, 65_536, 10**9))
    if kind == "7":
        return (
            f"P7\nWIDTH {w}\nHEIGHT {h}\nDEPTH {rng.choice((1, 3, 4, 10**6))}\nMAXVAL {full}\nTUPLTYPE RGB\nENDHDR\n".encode()
            + bytes(100)
        )
    gap = rng.choice((" ", "\n", "\n# a\n", "\t"))
    return f"P{kind}{gap}{w}{gap}{h}{gap}{full}\n".encode() + bytes(rng.choice((0, 100, 4000)))


def _bmp(w: int, h: int, rng: random.Random) -> bytes:
    depth, packed = rng.choice((1, 4, 8, 16, 24, 32)), rng.choice((0, 1, 2, 3))
    head = struct.pack("<IiiHHIIiiII", 40, _signed(w), _signed(h), 1, depth, packed, 0, 0, 0, rng.choice((0, 256, 2**31)), 0)
    return b"BM" + struct.pack("<IHHI", 54 + 100, 0, 0, 54) + head + bytes(100)


def _tiff(w: int, h: int, rng: random.Random) -> bytes:
    tiled = rng.random() < 0.3
    tags = [
        (256, 4, 1, w), (257, 4, 1, h), (258, 3, 1, rng.choice((1, 8, 16, 32))), (259, 3, 1, rng.choice((1, 5, 7, 8, 32773))),
        (262, 3, 1, rng.choice((0, 1, 2, 3, 6))), (277, 3, 1, rng.choice((1, 3, 4, 60_000))), (278, 4, 1, rng.choice((1, h))),
    ]  # fmt: skip
    tags += (
        [(322, 4, 1, w), (323, 4, 1, h), (324, 4, 1, 8), (325, 4, 1, 100)]
        if tiled
        else [(273, 4, 1, 8), (279, 4, 1, rng.choice((100, 2**32 - 1)))]
    )
    tags += [(60_000 + n, rng.choice((2, 4, 12, 99)), rng.choice((1, 2**31)), 8) for n in range(rng.choice((0, 0, 1, 100)))]
    body = struct.pack("<H", len(tags)) + b"".join(
        struct.pack("<HHII", *(tag[0], tag[1], tag[2], tag[3] & 0xFFFFFFFF)) for tag in sorted(tags)
    )
    start = 8 + 200
    return b"II*\0" + struct.pack("<I", start) + bytes(200) + body + struct.pack("<I", rng.choice((0, start)))


def _webp(w: int, h: int, rng: random.Random) -> bytes:
    match rng.randrange(3):
        case 0:
            body = (
                b"VP8X"
                + struct.pack("<I", 10)
                + bytes(4)
                + struct.pack("<I", w & 0xFFFFFF)[:3]
                + struct.pack("<I", h & 0xFFFFFF)[:3]
            )
        case 1:
            body = (
                b"VP8L"
                + struct.pack("<I", 100)
                + b"\x2f"
                + struct.pack("<I", ((w - 1) & 0x3FFF) | (((h - 1) & 0x3FFF) << 14))
                + bytes(95)
            )
        case _:
            body = (
                b"VP8 " + struct.pack("<I", 100) + b"\0\0\0\x9d\x01\x2a" + struct.pack("<HH", w & 0x3FFF, h & 0x3FFF) + bytes(90)
            )
    return b"RIFF" + struct.pack("<I", len(body) + 4) + b"WEBP" + body


def _others(w: int, h: int, rng: random.Random) -> bytes:
    """Formats that nobody asked for, under the name of one that somebody did."""
    match rng.randrange(5):
        case 0:
            return (
                b"GIF89a"
                + struct.pack("<HHBBB", w & 0xFFFF, h & 0xFFFF, 0x80, 0, 0)
                + bytes(6)
                + b","
                + struct.pack("<HHHHB", 0, 0, w & 0xFFFF, h & 0xFFFF, 0)
                + b"\2\2L\1\0;"
            )
        case 1:
            return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {h} +X {w}\n".encode() + bytes(200)
        case 2:
            siz = (
                struct.pack(">HIIIIIIIIH", 0, w & 0xFFFFFFFF, h & 0xFFFFFFFF, 0, 0, w & 0xFFFFFFFF, h & 0xFFFFFFFF, 0, 0, 3)
                + b"\7\1\1" * 3
            )
            return b"\xff\x4f\xff\x51" + struct.pack(">H", len(siz) + 2) + siz + bytes(100)
        case 3:
            return b"\x59\xa6\x6a\x95" + struct.pack(">7I", w & 0xFFFFFFFF, h & 0xFFFFFFFF, 24, 100, 1, 0, 0) + bytes(100)
        case _:
            window = struct.pack("<4i", 0, 0, _signed(w), _signed(h))
            return (
                b"v/1\x01\x02\0\0\0"
                + b"dataWindow\0box2i\0"
                + struct.pack("<I", 16)
                + window
                + b"displayWindow\0box2i\0"
                + struct.pack("<I", 16)
                + window
                + bytes(50)
            )


def _pfm(w: int, h: int, rng: random.Random) -> bytes:
    scale = rng.choice(("-1.0", "1.0", "0", "nan", "-1e400", "--", "-inf"))
    return f"{rng.choice(('Pf', 'PF', 'Pf '))}\n{w} {h}\n{scale}\n".encode() + bytes(rng.choice((0, 4, 4000)))


def _signed(n: int) -> int:
    return (n + 2**31) % 2**32 - 2**31


FORMATS = {".png": _png, ".jpg": _jpeg, ".ppm": _pnm, ".bmp": _bmp, ".tif": _tiff, ".webp": _webp, ".gif": _others, ".pfm": _pfm}


def claiming(rng: random.Random, suffix: str = "") -> bytes:
    """A picture that claims hostile sizes. suffix: of the format; any format where it is empty, or now and then."""
    made = FORMATS.get(suffix)
    if made is None or rng.random() < 0.3:
        made = rng.choice(list(FORMATS.values()))
    w, h = rng.choice(((20_000, 20_000), (rng.choice(SIZES), rng.choice(SIZES))))
    return made(w, h, rng)
