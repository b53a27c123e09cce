"""A stereo pair: two files (left and right, Middlebury's im2 and im6), or one picture of both (side by side, above one
another, .jps, .mpo). Two views, left eye first.

.jps: side by side, right eye first (VRex's format). .mpo: whole JPEGs one after the other, left eye first; CIPA DC-007.
"""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.decoding import picture_of
from lfpipe.files.pictures import header_of, read_picture
from lfpipe.scene.files import Listing, read_bytes
from lfpipe.scene.layouts._grid import files_source
from lfpipe.scene.layouts._names import LEFT, MAPS, RIGHT
from lfpipe.scene.layouts._tiles import single_picture
from lfpipe.scene.layouts._views import some
from lfpipe.scene.optical_flow import confirmed, flow, textured
from lfpipe.scene.source import SceneSource, Turn

NAME = "stereo"
_SIDES = re.compile(rf"(?<![a-z])({'|'.join(LEFT + RIGHT)})(?![a-z])")
_NUMBERED = {"im2": "im6", "im0": "im1", "view1": "view5", "img_left": "img_right"}  # Middlebury's pairs, the left one first
_BESIDE = re.compile(r"(?<![a-z])(h?sbs|half[-_ ]?sbs|side[-_ ]?by[-_ ]?side|parallel)(?![a-z])")
_CROSSED = re.compile(r"cross[-_ ]?ey|(?<![a-z])(xeye|rl)(?![a-z])")
_ABOVE = re.compile(r"(?<![a-z])(h?ou|h?tb|over[-_ ]?under|top[-_ ]?bottom)(?![a-z])")
_HALF = re.compile(r"(?<![a-z])(h|half[-_ ]?)(sbs|ou|tb|width|over|top|side)")
_VIDEO_ASPECTS = (1.7, 1.85)  # a picture of this shape holds halves squeezed to half their width
_GLANCE_PX = 384  # longer side of the compared halves
_ALIKE, _AGREED = 0.5, 0.5  # correlation of two halves; share of their detail that flow matches
_MAX_MPO_BYTES, _MAX_MPO_DECODED_BYTES = 40_000_000, 60_000_000  # of the file, and of each picture


def _pairs(listing: Listing) -> list[tuple[str, str]]:
    """The names of left and right pictures of a folder."""
    if listing.is_file:
        return []
    by_stem = {name.rpartition(".")[0].lower(): name for name in listing.pictures()}  # with the folder, if it is part of the name
    for left, right in _NUMBERED.items():
        text = left.rstrip("0123456789")
        line = [int(stem[len(text) :]) for stem in by_stem if re.fullmatch(text + r"\d{1,4}", stem)]
        runs = len(line) > 2 and max(line) - min(line) < len(line)  # all views of such a set, not two of them
        if left in by_stem and right in by_stem and not runs:
            return [(by_stem[left], by_stem[right])]
    sides: dict[str, dict[bool, str]] = {}
    for stem, name in by_stem.items():
        words = list(_SIDES.finditer(stem.replace("_", " ")))
        if words:
            rest = stem[: words[-1].start()] + "*" + stem[words[-1].end() :]
            sides.setdefault(rest, {})[words[-1][1] in LEFT] = name
    return [(both[True], both[False]) for both in sides.values() if len(both) == 2]


def _alone(listing: Listing) -> Path | None:
    """The only file of the scene that may hold both pictures."""
    names = [name for name in listing.names if name.lower().endswith((".jps", ".mpo"))]
    return listing.file(names[0]) if len(names) == 1 else single_picture(listing)


def _halves(picture: NDArray[Any], above: bool) -> tuple[NDArray[Any], NDArray[Any]]:
    height, width = picture.shape[0] // 2, picture.shape[1] // 2
    if above:
        return picture[:height], picture[height : 2 * height]
    return picture[:, :width], picture[:, width : 2 * width]


def are_a_pair(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether two pictures of equal size show one scene from two positions side by side."""
    scale = min(1.0, _GLANCE_PX / max(a.shape[:2]))
    greys = []
    for picture in (a, b):
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)  # first: a large one is not copied
        plane = small if small.ndim == 2 else small[..., 1]
        plane = plane if plane.dtype == np.uint8 else cv2.convertScaleAbs(np.ascontiguousarray(plane), alpha=1 / 256)
        greys.append(np.ascontiguousarray(plane, np.uint8))
    if min(greys[0].shape) < 24 or min(float(grey.std()) for grey in greys) < 2:
        return False
    a_soft, b_soft = (np.asarray(cv2.GaussianBlur(grey, (0, 0), 4), np.float64).ravel() for grey in greys)
    if float(np.corrcoef(a_soft, b_soft)[0, 1]) < _ALIKE:
        return False
    there, back = flow(greys[0], greys[1]), flow(greys[1], greys[0])
    detail = textured(greys[0])
    if not detail.any():
        return False
    found = confirmed(there, back) & (np.abs(there[..., 1]) < 1.5 + 0.1 * np.abs(there[..., 0]))
    return float(found[detail].mean()) > _AGREED


def _arrangement(path: Path) -> tuple[bool, bool, bool] | None:
    """(one above the other, half width or height, named so) of a picture of two; None if it is not one."""
    name = path.stem.lower().replace("_", " ")
    if path.suffix.lower() == ".jps":
        return False, bool(_HALF.search(name)), True
    picture, _ = read_picture(path)
    aspect = picture.shape[1] / picture.shape[0]
    for above, word in ((False, _BESIDE), (True, _ABOVE)):
        named = bool(word.search(name))
        likely = aspect > 1.2 if not above else aspect < 1.0 or _VIDEO_ASPECTS[0] < aspect < _VIDEO_ASPECTS[1]
        if (named or likely) and are_a_pair(*_halves(picture, above)):
            return above, bool(_HALF.search(name)) or _VIDEO_ASPECTS[0] < aspect < _VIDEO_ASPECTS[1], named
    return None


def detect(listing: Listing) -> int | None:
    if pairs := _pairs(listing):
        paired = {name for pair in pairs for name in pair}
        others = [name for name in listing.pictures() if name not in paired and not MAPS.search(name)]
        if not others or Path(pairs[0][0]).stem.lower() in _NUMBERED or "/" in pairs[0][0]:
            return 85
        if len(pairs) == 1:
            return 45
    path = _alone(listing)
    if path is None:
        return None
    if path.suffix.lower() in (".jps", ".mpo"):
        return 95
    try:
        found = _arrangement(path)
    except UserError:
        return None
    # the halves of a mosaic are also alike: without a word in the name, tiles come first
    return None if found is None else 65 if found[2] else 55


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    if pairs := _pairs(listing):
        others = [name for name in listing.pictures() if name not in pairs[0]]
        notes = (f"2 of {len(others) + 2} files used; the others are {some(others)}",) if others else ()
        files = {(0, col): listing.file(name) for col, name in enumerate(pairs[0])}
        return files_source(NAME, listing, files, 1, 2, turn=Turn(), turn_by="the names say left and right", notes=notes)
    path = _alone(listing)
    if path is None:
        what = f"{listing.path}: no stereo pair among {len(listing.pictures())} pictures"
        raise UserError(what, "name two of them x_left.png and x_right.png")
    views, full, turn, why = _mpo(path) if path.suffix.lower() == ".mpo" else _divided(path)
    return SceneSource(
        certain=turn is not None, layout=NAME, path=listing.path, files=(path,), rows=1, cols=2,
        read=lambda frame, row, col: views[col], height_px=views[0].shape[0], width_px=views[0].shape[1], max_value=full,
        turn=turn, turn_by=why,
    )  # fmt: skip


def _divided(path: Path) -> tuple[list[NDArray[Any]], int, Turn | None, str]:
    """(views in file order, full value, turn or None, why) of a picture of two. Raises UserError."""
    found = _arrangement(path)
    if found is None:
        raise UserError(
            f"{path}: its halves are no stereo pair, neither side by side nor above one another",
            "give two files x_left.png and x_right.png",
        )
    picture, full = read_picture(path)
    above, half, named = found
    views = [np.ascontiguousarray(part) for part in _halves(picture, above)]
    if half:
        height, width = views[0].shape[:2]
        size = (width, 2 * height) if above else (2 * width, height)
        views = [np.asarray(cv2.resize(view, size, interpolation=cv2.INTER_LINEAR)) for view in views]
    if path.suffix.lower() == ".jps":
        return views, full, Turn(cols=True), "a .jps file begins with the right eye's picture"
    if _CROSSED.search(path.stem.lower().replace("_", " ")):
        return views, full, Turn(cols=True), "the name says that it is for crossed eyes"
    if named:
        return views, full, Turn(), "the name gives a format that begins with the left eye's picture"
    return views, full, None, ""


def _mpo(path: Path) -> tuple[list[NDArray[Any]], int, Turn | None, str]:
    """The first two pictures of an .mpo file, as `_divided`. Raises UserError."""
    whole = read_bytes(path, _MAX_MPO_BYTES)
    data = np.frombuffer(whole, np.uint8)
    views: list[NDArray[Any]] = []
    for start in (0, _second_jpeg(whole)):
        header = header_of(data[start:].data) if start is not None else None
        small = header is not None and header.decoded_bytes <= _MAX_MPO_DECODED_BYTES
        found = picture_of(data[start:]) if small else None
        if found is None:
            raise UserError(f"{path}: no two JPEGs in this .mpo file", "copy it from the camera again")
        views.append(np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2RGB, dst=found)))
    if views[0].shape != views[1].shape:
        sizes = " and ".join(f"{view.shape[1]}x{view.shape[0]}" for view in views)
        raise UserError(f"{path}: pictures of {sizes} px are not a stereo pair", "give a file of two equal pictures")
    return views, 255, Turn(), "an .mpo file begins with the left eye's picture"


def _second_jpeg(data: bytes) -> int | None:
    """The offset of the second JPEG of an .mpo file, from its index (APP2 "MPF": a TIFF whose tag 0xB002 lists the pictures)."""
    mark = data.find(b"MPF\0", 0, 1 << 17)
    tiff = mark + 4
    if mark < 0 or data[tiff : tiff + 4] not in (b"II*\0", b"MM\0*"):
        return None

    def number(at: int, size: int) -> int:
        return int.from_bytes(data[at : at + size], "little" if data[tiff] == ord("I") else "big")

    table = tiff + number(tiff + 4, 4)
    for entry in range(table + 2, table + 2 + 12 * min(number(table, 2), 64), 12):
        if number(entry, 2) == 0xB002 and number(entry + 4, 4) >= 32:
            start = tiff + number(tiff + number(entry + 8, 4) + 16 + 8, 4)
            return start if data[start : start + 3] == b"\xff\xd8\xff" else None
    return None
