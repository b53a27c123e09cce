"""What files state about themselves: XMP and what it lists behind a photograph, the descriptor of a
stereo JPEG, the arrangement in a film's container, the time of a photograph.

Statements beat the words of names, and those beat the pictures.
"""

import base64
import contextlib
import io
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.ExifTags import IFD, Base

from lfpipe.errors import UserError
from lfpipe.files.pictures import FORMATS, MAX_DECODING_BYTES, heic_depth, open_header
from lfpipe.files.safe_files import finite, open_file
from lfpipe.scene.video import film_ends, is_spatial

_HEIC = (".heic", ".heif")
_EXTENDED = b"http://ns.adobe.com/xmp/extension/\0"  # then 32 bytes of its name, size and offset
_PICTURE = re.compile(rb"\xff\xd8\xff|\x89PNG\r\n")
_MAYBE_DEPTH = re.compile(rb"depth|disparity|edof", re.IGNORECASE)
_BEHIND_BYTES = 64  # after the end of a photograph, within which a second picture begins
# descriptor of a stereo JPEG: bytes of the kind and the arrangement, and bits of a third byte
_STEREO, _SIDE_BY_SIDE, _OVER_UNDER = 1, 2, 3
_HALF_WIDTH, _LEFT_FIRST = 2, 4
# in Matroska before its first cluster: StereoMode (element 53B8), then its size and value
_CLUSTER, _STEREO_MODE = b"\x1f\x43\xb6\x75", re.compile(rb"\x53\xb8\x81(.)", re.DOTALL)
# box of MP4 and QuickTime: its version and flags, then its value
_ST3D, _STRI = (re.compile(name + rb".{4}(.)", re.DOTALL) for name in (b"st3d", b"stri"))
# (which arrangement, the right eye's picture first), by the value of each
_MATROSKA = {
    1: ("beside", False),
    2: ("above", True),
    3: ("above", False),
    11: ("beside", True),
    4: ("checks", True),
    5: ("checks", False),
    6: ("lines", True),
    7: ("lines", False),
    8: ("columns", True),
    9: ("columns", False),
}
_BOXED = {1: ("above", False), 2: ("beside", False), 4: ("beside", True)}
_REVERSED_EYES = 8  # of the box stri: the first layer is the right eye's


@attrs.frozen(kw_only=True)
class Halves:
    """The arrangement of two views in one picture."""

    form: str = (
        "beside"  # each other; or one above the other; or alternating lines, columns, checks
    )
    squeezed: bool = False  # to half the width or height
    crossed: bool = False  # the right eye's picture comes first
    why: str = ""  # what says that, "" for nothing
    mark: int = 95  # as `detect` returns it
    streams: bool = False  # not in one picture: in two streams or layers of a film
    note: str = ""


def time_of_photograph(path: Path) -> str:
    """When a photograph was taken, as its EXIF states it; "" if unknown."""
    with (
        contextlib.suppress(Exception),  # of any parser
        open_file(path) as file,
        Image.open(file, formats=("JPEG", "HEIF")) as image,
    ):
        exif = image.getexif().get_ifd(IFD.Exif)
        return f"{exif[Base.DateTimeOriginal]}.{exif.get(Base.SubsecTimeOriginal, '')}"
    return ""


def _packets(data: bytes) -> Iterator[bytes]:
    """The XMP of a picture, and what is extended from it: a JPEG's segments are short."""
    with Image.open(io.BytesIO(data), formats=FORMATS) as image:
        yield image.info.get("xmp", b"")
        parts = sorted(
            (body[len(_EXTENDED) :][:40], body[len(_EXTENDED) + 40 :])
            for _, body in getattr(image, "applist", ())
            if body.startswith(_EXTENDED)
        )
    for name in dict.fromkeys(head[:32] for head, _ in parts):
        yield b"".join(part for head, part in parts if head.startswith(name))


def _records(packet: bytes) -> Iterator[dict[str, str]]:
    """The properties of each element of an XML document, whether attributes or elements, by the
    last word of their namespace and their name: item:Length.
    """
    with contextlib.suppress(ElementTree.ParseError):
        for element in ElementTree.fromstring(packet.strip(b"\0 \r\n\t")).iter():
            values = {**element.attrib, **{one.tag: one.text or "" for one in element}}
            yield {_property(key): value.strip() for key, value in values.items()}


def _property(key: str) -> str:
    space, _, name = key.rpartition("}")
    return f"{space.rstrip('/').rpartition('/')[2]}:{name}"


def _xmp(data: bytes) -> list[dict[str, str]]:
    with contextlib.suppress(Exception):  # of any parser
        return [one for packet in _packets(data) if packet for one in _records(packet)]
    return []


def _items(records: list[dict[str, str]]) -> list[dict[str, str]]:
    """What a directory lists: the picture, and what is behind it."""
    return [one for one in records if "item:Mime" in one or "item:Semantic" in one]


def _coded_depth(data: bytes) -> tuple[bytes, dict[str, str]] | None:
    """(the coded depth map in a photograph, what is stated about it): of GDepth, in the XMP itself,
    or of Dynamic Depth, an item behind the picture; b"" if it is not there. None if none is stated.
    """
    records = _xmp(data)
    stated = {
        key.partition(":")[2]: value
        for one in records
        for key, value in one.items()
        if key.startswith("depthmap:")
    }
    if "Data" in stated:
        with contextlib.suppress(ValueError):  # damaged
            return base64.b64decode(stated["Data"]), stated
    items = _items(records)
    for at, item in enumerate(items):
        uri = item.get("item:DataURI")
        if (uri and uri == stated.get("DepthURI")) or item.get("item:Semantic") == "Depth":
            lengths = [int(finite(one.get("item:Length", ""), 0, 1e9) or 0) for one in items[at:]]
            return _item(data, lengths), stated
    return (b"", stated) if stated else None


def _item(data: bytes, lengths: list[int]) -> bytes:
    """The item of the first length; the last one ends with the file, unless it does not begin there
    because other data follow.
    """
    starts = [len(data) - sum(lengths), *(match.start() for match in _PICTURE.finditer(data, 3))]
    for start in starts:
        item = data[max(0, start) :][: lengths[0]]
        whole = item.startswith(b"\x89") or item.rstrip(b"\0").endswith(b"\xff\xd9")
        if start > 0 and _PICTURE.match(item) and whole:
            return item
    return b""


def embedded_depth(path: Path) -> NDArray[np.float32] | None:
    """The depth map in a photograph, (h, w), larger is nearer; None if there is none that can be
    read. Raises UserError.
    """
    if path.suffix.lower() in _HEIC:
        return heic_depth(path) if open_header(path).has_depth else None
    coded, stated = _coded_depth(_read(path)) or (b"", {})
    pixels = None
    if coded:
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        pixels = cv2.imdecode(np.frombuffer(coded, np.uint8), flags)
    if pixels is None:
        return None
    values = pixels.astype(np.float32)
    near, far = (finite(stated.get(key, ""), 1e-6, 1e9) for key in ("Near", "Far"))
    if stated.get("Format") == "RangeLinear" and near and far:
        share = values / np.float32(255 if pixels.dtype == np.uint8 else 65535)
        return np.asarray(1 / (near + share * (far - near)), np.float32)
    return -values


def unread_depth(path: Path) -> str:
    """A note of data behind a photograph that may be depth; "" if there are none."""
    data = _read(path)
    stated = _coded_depth(data) is not None
    items = _items(_xmp(data))
    at = 2
    while (mark := data[at : at + 2])[:1] == b"\xff" and mark not in (
        b"\xff",
        b"\xff\xda",
    ):  # to the start of the scan
        at += 2 + int.from_bytes(data[at + 2 : at + 4])
    behind = data[data.find(b"\xff\xd9", at) :] if data.startswith(b"\xff\xd8") else b""
    second = _PICTURE.search(behind[:_BEHIND_BYTES]) and not items and not open_header(path).beside
    if not (stated or _MAYBE_DEPTH.search(behind) or second):
        return ""
    return (
        f"{path.name} holds data that may be depth and are not read: export the depth map as"
        f" {path.stem}_depth.png beside it"
    )


def _read(path: Path) -> bytes:
    with open_file(path) as file:
        return file.read(MAX_DECODING_BYTES)


def described(path: Path, descriptor: int) -> Halves | None:
    """The arrangement by the descriptor of a stereo JPEG; None if it is one view. Raises UserError
    if the views cannot be taken apart.
    """
    kind, layout, flags = (descriptor >> shift & 0xFF for shift in (0, 8, 16))
    if kind != _STEREO:
        return None
    if layout not in (_SIDE_BY_SIDE, _OVER_UNDER):
        raise UserError(
            f"{path}: its descriptor says that the pictures of both eyes are interleaved or"
            " overlaid",
            "export them side by side, or as two files x_left.png and x_right.png",
        )
    form, crossed = "above" if layout == _OVER_UNDER else "beside", not flags & _LEFT_FIRST
    squeezed = form == "beside" and bool(flags & _HALF_WIDTH)
    return Halves(
        form=form, squeezed=squeezed, crossed=crossed, why=_why("its descriptor", crossed)
    )


def contained(path: Path) -> Halves | None:
    """The arrangement that a film's container states; None if it states none. Raises UserError."""
    start, end = film_ends(path)
    if start.startswith(b"\x1aE"):
        modes = [m[1][0] for m in _STEREO_MODE.finditer(start.partition(_CLUSTER)[0])]
        stated = next((_MATROSKA[mode] for mode in modes if mode in _MATROSKA), None)
    elif is_spatial(path):
        flags = _STRI.search(start + end)
        crossed = flags is not None and bool(flags[1][0] & _REVERSED_EYES)
        return Halves(streams=True, crossed=crossed, why=_why("its container", crossed))
    else:
        boxes = [_BOXED.get(match[1][0]) for match in _ST3D.finditer(start + end)]
        stated = next(filter(None, boxes), None)
    return stated and Halves(
        form=stated[0], crossed=stated[1], why=_why("its container", stated[1])
    )


def _why(what: str, crossed: bool) -> str:
    return f"{what} says that the {'right' if crossed else 'left'} eye's picture comes first"
