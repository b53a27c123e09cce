"""Stereo JPEGs as cameras and programs write them: with an index of several pictures (CIPA DC-007),
or with a descriptor (VRex's JPS).
"""

import struct

DISPARITY, PANORAMA, THUMBNAIL, UNDEFINED = 0x020002, 0x020001, 0x010001, 0x000000


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def _table(entries: list[tuple[int, int, int, bytes]], at: int, following: int) -> bytes:
    """A directory at that offset, little-endian; values of more than 4 bytes follow it."""
    data_at = at + 2 + 12 * len(entries) + 4
    head = struct.pack("<H", len(entries))
    data = b""
    for tag, kind, count, value in entries:
        place = value.ljust(4, b"\0")
        if len(value) > 4:
            place = struct.pack("<I", data_at + len(data))
            data += value
        head += struct.pack("<HHI", tag, kind, count) + place
    return head + struct.pack("<I", following) + data


def _number_of(number: int, at: int) -> bytes:
    return _table([(0xB101, 4, 1, struct.pack("<I", number))], at, 0)


def indexed(jpegs: list[bytes], kinds: list[int], numbers: list[int] | None = None) -> bytes:
    """JPEGs in one file with an index of their kinds. numbers: of each among its like."""
    parts = [
        jpeg[:2]
        + (
            _segment(0xE2, b"MPF\0II*\0\x08\0\0\0" + _number_of(number, 8))
            if numbers and at
            else b""
        )
        + jpeg[2:]
        for at, (jpeg, number) in enumerate(zip(jpegs, numbers or [0] * len(jpegs), strict=True))
    ]

    def index(offsets: list[int], sizes: list[int]) -> bytes:
        entries = b"".join(
            struct.pack("<IIIHH", kind, size, offset, 0, 0)
            for kind, size, offset in zip(kinds, sizes, offsets, strict=True)
        )
        values = [
            (0xB000, 7, 4, b"0100"),
            (0xB001, 4, 1, struct.pack("<I", len(jpegs))),
            (0xB002, 7, len(entries), entries),
        ]
        table = _table(values, 8, 0)
        own = b""
        if numbers:
            table = _table(values, 8, 8 + len(table))
            own = _number_of(numbers[0], 8 + len(table))
        return _segment(0xE2, b"MPF\0II*\0\x08\0\0\0" + table + own)

    length = len(index([0] * len(jpegs), [0] * len(jpegs)))
    sizes = [len(parts[0]) + length, *map(len, parts[1:])]
    begins = [sum(sizes[:at]) for at in range(len(parts))]
    base = 2 + 4 + 4  # of the offsets: behind the segment's name
    offsets = [0, *(begin - base for begin in begins[1:])]
    return parts[0][:2] + index(offsets, sizes) + parts[0][2:] + b"".join(parts[1:])


def described(jpeg: bytes, layout: int, flags: int, kind: int = 1) -> bytes:
    """A JPEG with the descriptor of a stereo JPEG."""
    body = b"_JPSJPS_" + struct.pack(">HBBBBH", 4, 0, flags, layout, kind, 0)
    return jpeg[:2] + _segment(0xE3, body) + jpeg[2:]
