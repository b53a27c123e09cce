"""Depth maps inside JPEGs, as in portrait photographs by phones: GDepth (in extended XMP) and
Dynamic Depth (appended items). HEIC files store depth maps as separate images.

GDepth: https://developers.google.com/depthmap-metadata/reference; Dynamic Depth 1.0, an XMP
directory of the items after the picture; XMP Part 3 (Adobe) for its parts in a JPEG. In both,
larger values are farther away.
"""

import base64
import contextlib
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.pictures import heic_depth, open_header
from lfpipe.files.untrusted import finite
from lfpipe.scene.files import read_bytes

HEIC = (".heic", ".heif")
MAX_BYTES = 60_000_000  # of a photograph with its embedded items
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
# size and offset of a part
_MORE = re.compile(rb"\xff\xe1(..)http://ns\.adobe\.com/xmp/extension/\0.{36}(.{4})", re.DOTALL)
_ITEM = re.compile(rb"<\w+:Item\b([^>]{0,2000})>")


def _packet(data: bytes) -> bytes:
    """The XMP of a JPEG; b"" if it has none."""
    at = data.find(_XMP)
    return data[at : at - 2 + int.from_bytes(data[at - 2 : at])] if at >= 0 else b""


def _value(xmp: bytes, name: bytes) -> bytes | None:
    match = re.search(rb"\b" + name + rb"\s*=\s*[\"']([^\"']*)", xmp) or re.search(
        rb"<" + name + rb">([^<]*)", xmp
    )
    return match[1] if match else None


def _depth_item(packet: bytes, data: bytes) -> bytes | None:
    """The depth item of the directory in a picture's XMP; None if there is none. Items are
    appended to the picture, up to the end of the file.
    """
    end = len(data)
    for item in reversed(_ITEM.findall(packet)):
        length = re.search(rb"Item:Length\s*=\s*[\"'](\d{1,12})", item)
        start = end - int(length[1] if length else 0)
        if (_value(item, rb"\w*Item:Semantic") or b"").lower() == b"depth":
            return data[start:end] if start > 0 else b""
        end = start
    return None


def has_depth(path: Path) -> bool:
    """Whether a JPEG declares a depth map, or a HEIC picture has one. Raises UserError."""
    if path.suffix.lower() in HEIC:
        return open_header(path).has_depth
    if path.suffix.lower() not in (".jpg", ".jpeg"):
        return False
    packet = _packet(read_bytes(path, MAX_BYTES))
    return (
        _depth_item(packet, b"") is not None
        or b"GDepth:Format" in packet
        or b"GDepth:Mime" in packet
    )


def embedded_depth(path: Path) -> NDArray[Any]:
    """The depth map of a photograph, (h, w) float32, larger is nearer. Raises UserError."""
    if path.suffix.lower() in HEIC:
        return heic_depth(path)
    data = read_bytes(path, MAX_BYTES)
    parts = sorted(
        (head[2], data[head.end() : head.start() + 2 + int.from_bytes(head[1])])
        for head in _MORE.finditer(data)
    )
    packet = _packet(data)
    pixels = None
    whole = packet + b"".join(body for _, body in parts)
    with contextlib.suppress(ValueError, cv2.error):
        stored = _value(whole, b"GDepth:Data")
        coded = (
            base64.b64decode(stored, validate=True) if stored else _depth_item(packet, data) or b""
        )
        pixels = cv2.imdecode(
            np.frombuffer(coded, np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        )
    if pixels is None:
        remedy = "export the picture and its depth as x.png and x_depth.png, and give their folder"
        raise UserError(f"{path}: claims to contain a depth map, but has no readable one", remedy)
    share = pixels.astype(np.float32) / np.float32(65535 if pixels.dtype == np.uint16 else 255)
    near, far = (
        finite((_value(whole, rb"\w*Depth:" + name) or b"").decode("latin-1"), 0)
        for name in (b"Near", b"Far")
    )
    linear = (_value(whole, rb"\w*Depth:Format") or b"").lower() == b"rangelinear"
    if not linear or near is None or far is None or not 0 < near < far:
        return np.asarray(1 - share, np.float32)
    return np.asarray(near / (near + share * np.float32(far - near)), np.float32)
