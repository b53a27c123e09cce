"""HEIC files as phones write them, made by pillow-heif; groups and depth are added box by box
(ISO/IEC 14496-12 and 23008-12), because no encoder writes them.
"""

import io
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Picture = NDArray[np.uint8]


def _box(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", 8 + len(body)) + kind + body


def _boxes(data: bytes) -> list[tuple[bytes, bytes]]:
    """(kind, body) of consecutive boxes."""
    listed = []
    while data:
        (size,) = struct.unpack(">I", data[:4])
        listed.append((data[4:8], data[8:size]))
        data = data[size:]
    return listed


def _with_property(iprp: bytes, item: int, new: bytes) -> bytes:
    """The body of an iprp box with one more property, of an item."""
    (_, ipco), (_, ipma) = _boxes(iprp)
    index = len(_boxes(ipco)) + 1
    at = 8
    while struct.unpack(">H", ipma[at : at + 2])[0] != item:
        at += 3 + ipma[at + 2]
    end = at + 3 + ipma[at + 2]
    entry = ipma[at : at + 2] + bytes([ipma[at + 2] + 1]) + ipma[at + 3 : end] + bytes([index])
    return _box(b"ipco", ipco + new) + _box(b"ipma", ipma[:at] + entry + ipma[end:])


def write(
    path: Path,
    pictures: list[Picture],
    group: tuple[bytes, int, int] | None = None,
    depth: Picture | None = None,
) -> Path:
    """Writes RGB pictures; group: its type and two items (from 1), depth: of the first picture."""
    import pillow_heif

    file = pillow_heif.HeifFile()  # type: ignore[no-untyped-call]
    for picture in [*pictures, *([] if depth is None else [depth])]:
        file.add_from_pillow(Image.fromarray(picture))
    buffer = io.BytesIO()
    file.save(buffer, quality=-1, chroma=444)
    data = buffer.getvalue()
    meta = dict(_boxes(data))[b"meta"]
    children = dict(_boxes(meta[4:]))
    if group is not None:
        kind, first, second = group
        children[b"grpl"] = _box(kind, struct.pack(">5I", 0, 100, 2, first, second))
    if depth is not None:
        item = len(pictures) + 1
        kind_of = _box(b"auxC", bytes(4) + b"urn:mpeg:hevc:2015:auxid:2\0")
        children[b"iprp"] = _with_property(children[b"iprp"], item, kind_of)
        reference = _box(b"auxl", struct.pack(">3H", item, 1, 1))
        children[b"iref"] = bytes(4) + reference
    grown = meta[:4] + b"".join(_box(kind, body) for kind, body in children.items())
    # the pictures stay where they are: the old box is skipped, and a new one follows them
    path.write_bytes(data.replace(b"meta", b"free", 1) + _box(b"meta", grown))
    return path
