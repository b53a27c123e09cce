"""Depth maps inside pictures, as in portrait photographs by phones: Dynamic Depth 1.0, an XMP
directory of the items after the picture in a JPEG, and HEIC, which stores depth maps as separate
images.
"""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.pictures import heic_depth, open_header
from lfpipe.scene.files import read_bytes

_HEIC = (".heic", ".heif")
MAX_BYTES = 60_000_000  # of a photograph with its embedded items
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_ITEM = re.compile(rb"<\w+:Item\b([^>]{0,2000})>")


def _item(data: bytes) -> bytes | None:
    """The depth item of a JPEG; None if its XMP lists none. Items are appended to the picture, up
    to the end of the file.
    """
    at = data.find(_XMP)
    packet = data[at : at - 2 + int.from_bytes(data[at - 2 : at])] if at >= 0 else b""
    end = len(data)
    for item in reversed(_ITEM.findall(packet)):
        length = re.search(rb"Item:Length\s*=\s*[\"'](\d{1,12})", item)
        start = end - int(length[1] if length else 0)
        if re.search(rb"Item:Semantic\s*=\s*[\"']depth[\"']", item, re.IGNORECASE):
            return data[max(0, start) : max(0, end)]
        end = start
    return None


def has_depth(path: Path) -> bool:
    """Whether a JPEG lists a depth map, or a HEIC picture has one. Raises UserError."""
    if path.suffix.lower() in _HEIC:
        return open_header(path).has_depth
    return path.suffix.lower() in (".jpg", ".jpeg") and (
        _item(read_bytes(path, MAX_BYTES)) is not None
    )


def embedded_depth(path: Path) -> NDArray[Any]:
    """The depth map of a photograph, (h, w) float32, larger is nearer. Raises UserError."""
    if path.suffix.lower() in _HEIC:
        return heic_depth(path)
    coded = np.frombuffer(_item(read_bytes(path, MAX_BYTES)) or b"", np.uint8)
    pixels = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH) if coded.size else None
    if pixels is None:
        remedy = "export the picture and its depth as x.png and x_depth.png, and give their folder"
        raise UserError(f"{path}: claims to contain a depth map, but has no readable one", remedy)
    return np.asarray(-pixels.astype(np.float32))
