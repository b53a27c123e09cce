"""A stereo pair: two files (left and right, Middlebury's im2 and im6), one picture or video of both
(side by side, above one another, .jps, .mpo, a spatial photo in HEIC), or a video of two streams.
Two views, left eye first.

What a JPEG says decides, whatever its ending: the index of its pictures (CIPA DC-007, usually
.mpo), or a descriptor (VRex's format, usually .jps; without it, the right eye's half comes first).
"""

import re
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_frames, read_picture
from lfpipe.scene.files import VIDEOS, Listing
from lfpipe.scene.layouts._grid import MIN_VIEW_PX, files_source, some
from lfpipe.scene.layouts._names import MAPS, read_names, side_of
from lfpipe.scene.layouts._running import reduced
from lfpipe.scene.layouts._tiles import (
    halves,
    is_film,
    last_picture,
    plane_of,
    require_picture,
    single_picture,
)
from lfpipe.scene.optical_flow import returned_flow, textured
from lfpipe.scene.source import GridTransform, SceneSource
from lfpipe.scene.video import Video, second_stream, stream_count, telling_frame

NAME = "stereo"
# Middlebury's pairs, the left one first
_NUMBERED = {"im2": "im6", "im0": "im1", "view1": "view5", "img_left": "img_right"}
# folders of two cameras that recorded side by side
_CAMERA = re.compile(r"(image|img|cam|camera)s?[-_ ]?\d{1,2}")
# of names in lower case, with spaces for "_"
_FULL_OR_HALF = r"(?<![a-z])((h|half|f|full)?[-. ]?"
_BESIDE = re.compile(
    _FULL_OR_HALF + r"(sbs|side[- ]?by[- ]?side)|parallel|lr|rl|3dh|cross[- ]?eyed?|xeyed?"
    r"|(left|right)[- ]?(right|left))(?![a-z])"
)
_CROSSED = re.compile(
    r"cross[- ]?ey|(?<![a-z])(xeyed?|rl|right[- ]?left|h?bt|bottom[- ]?(and[- ]?)?top)(?![a-z])"
)
_ABOVE = re.compile(
    _FULL_OR_HALF + r"(ou|tab|tb|bt|over[- ]?(and[- ]?)?under"
    r"|(top|bottom)[- ]?(and[- ]?)?(top|bottom))|3dv)(?![a-z])"
)
_HALF = re.compile(r"(?<![a-z])(h|half)[-. ]?(sbs|ou|tb|tab|bt|width|over|top|bottom|side)")
_GLANCE_PX = 384  # longer side of the compared halves
_AGREED = 0.5  # minimum share of the detail of two halves that flow matches


# descriptor of a stereo JPEG: bytes of the kind and the arrangement, and bits of a third byte
_STEREO, _SIDE_BY_SIDE, _OVER_UNDER = 1, 2, 3
_HALF_WIDTH, _LEFT_FIRST = 2, 4


@attrs.frozen(kw_only=True)
class _Halves:
    """The arrangement of two views in one picture."""

    above: bool  # one above the other, else side by side
    squeezed: bool  # to half the width or height
    crossed: bool  # the right eye's picture comes first
    why: str  # what states that, "" for nothing
    mark: int  # as `detect` returns it
    streams: bool = False  # not in one picture: in two video streams


def _pairs(listing: Listing) -> list[tuple[str, str]]:
    """The names of left and right pictures of a folder."""
    # with the folder, if it is part of the name
    by_stem = {name.rpartition(".")[0].lower(): name for name in listing.pictures()}
    for left, right in _NUMBERED.items():
        numbered = sum(
            re.fullmatch(left.rstrip("0123456789") + r"\d{1,4}", stem) is not None
            for stem in by_stem
        )
        # more than two are all views of a Middlebury set
        if left in by_stem and right in by_stem and numbered <= 4:
            return [(by_stem[left], by_stem[right])]
    folders = sorted({stem.rpartition("/")[0] for stem in by_stem})
    cameras = len(folders) == 2 and all(
        _CAMERA.fullmatch(folder.partition("/")[0]) for folder in folders
    )
    sides: dict[str, dict[bool, str]] = {}
    for stem, name in by_stem.items():
        folder, _, rest = stem.rpartition("/")
        if side := side_of(stem) or ((rest, folder == folders[0]) if cameras else None):
            sides.setdefault(side[0], {})[side[1]] = name
    pairs = [(both[True], both[False]) for both in sides.values() if len(both) == 2]
    grid = read_names(tuple(left for left, _ in pairs)) if len(pairs) > 3 else None
    # two grids of cameras, left and right, are not an album of pairs
    return [] if grid is not None and not grid.runs else pairs


def _alone(listing: Listing) -> Path | None:
    """The only file of the scene that may contain both pictures."""
    if is_film(listing):
        return listing.file(listing.names[0])
    names = [name for name in listing.pictures() if name.lower().endswith((".jps", ".mpo"))]
    return listing.file(names[0]) if len(names) == 1 else single_picture(listing)


def are_a_pair(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether two pictures of equal size show one scene from two positions side by side."""
    greys = [plane_of(reduced(picture, _GLANCE_PX)) for picture in (a, b)]
    if min(greys[0].shape) < 24 or min(float(grey.std()) for grey in greys) < 2:
        return False
    to_right, confirmed = returned_flow(*greys)
    detail = textured(greys[0])
    agreed = confirmed & (np.abs(to_right[..., 1]) < 1.5 + 0.1 * np.abs(to_right[..., 0]))
    return bool(detail.any()) and float(agreed[detail].mean()) > _AGREED


def _looks(path: Path) -> list[NDArray[Any]]:
    """The picture at path; of a video, a frame that shows something, and of its second stream."""
    if not path.name.lower().endswith(VIDEOS):
        return [read_picture(path)[0]]
    number, picture = telling_frame(path)
    if stream_count(path) > 1 and find_spec("av"):
        with suppress(UserError):  # a stream that is declared and not there
            return [picture, Video(path, 1).read(number)]
    return [picture]


@lru_cache(maxsize=2)
def _arrangement(path: Path) -> _Halves | None:
    """The arrangement of the picture at path; None if it does not contain two views."""
    film = path.name.lower().endswith(VIDEOS)
    if not film and (descriptor := open_header(path).jps) is not None:
        return _described(path, descriptor)
    name = path.stem.lower().replace("_", " ")
    crossed = bool(_CROSSED.search(name))
    squeezed = bool(_HALF.search(name))
    why = "by name or format, the right eye's picture comes first"
    if path.suffix.lower() == ".jps":
        return _Halves(above=False, squeezed=squeezed, crossed=True, why=why, mark=95)
    picture, *second = _looks(path)
    if second and second[0].shape == picture.shape and are_a_pair(picture, second[0]):
        return _Halves(above=False, squeezed=False, crossed=False, why="", mark=55, streams=True)
    aspect = picture.shape[1] / picture.shape[0]
    for above, word, likely in (
        (False, _BESIDE, aspect > 1.2),
        (True, _ABOVE, aspect < 1.0),
    ):
        named = bool(word.search(name))
        if (named or likely) and are_a_pair(*halves(picture, above)):
            begins = "the name states a format that begins with the left eye's picture" * named
            return _Halves(
                above=above,
                squeezed=squeezed,
                crossed=crossed,
                why=why if crossed else begins,
                # the halves of a mosaic are alike, too: unless the name says so, tiles come first
                mark=65 if named else 55,
            )
    return None


def _described(path: Path, descriptor: int) -> _Halves | None:
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
    above = layout == _OVER_UNDER
    first = "left" if flags & _LEFT_FIRST else "right"
    return _Halves(
        above=above,
        squeezed=not above and bool(flags & _HALF_WIDTH),
        crossed=first == "right",
        why=f"its descriptor says that the {first} eye's picture comes first",
        mark=95,
    )


def _eyes(picture: NDArray[Any], arrangement: _Halves) -> list[NDArray[Any]]:
    """The two views of a picture."""
    views = [np.ascontiguousarray(view) for view in halves(picture, arrangement.above)]
    if not arrangement.squeezed:
        return views
    x, y = (1, 2) if arrangement.above else (2, 1)
    return [
        np.asarray(cv2.resize(view, None, fx=x, fy=y, interpolation=cv2.INTER_LINEAR))
        for view in views
    ]


def _filmed(
    path: Path, arrangement: _Halves
) -> tuple[Callable[[int], NDArray[Any]], dict[str, Any]]:
    """(both views by frame, fields of SceneSource) of a video. Raises UserError."""
    video = Video(path)
    both = [video, Video(path, 1)] if arrangement.streams else [video]

    def load(frame: int) -> NDArray[Any]:
        pictures = [one.read(frame) for one in both]
        return np.stack(pictures if arrangement.streams else _eyes(pictures[0], arrangement))

    return last_picture(load), {
        "frames": min(one.frames for one in both),
        "frame_rate_hz": video.rate_hz,
        "telling": telling_frame(path)[0],
        "notes": () if arrangement.streams else tuple(second_stream(path)),
    }


def detect(listing: Listing) -> int | None:
    if pairs := _pairs(listing):
        paired = {name for pair in pairs for name in pair}
        others = [
            name for name in listing.pictures() if name not in paired and not MAPS.search(name)
        ]
        if not others or Path(pairs[0][0]).stem.lower() in _NUMBERED or "/" in pairs[0][0]:
            return 85
        return 55  # left and right take precedence over rows and columns
    path = _alone(listing)
    if path is None:
        return None
    header = None if is_film(listing) else open_header(path)
    if header is not None and (
        header.holds_pair or (header.eyes and path.suffix.lower() == ".mpo")
    ):
        return 95
    if header is not None and header.eyes:
        return 95 if are_a_pair(*read_frames(path, header.eyes)) else None
    arrangement = _arrangement(path)
    return None if arrangement is None else arrangement.mark


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    if pairs := _pairs(listing):
        others = [name for name in listing.pictures() if name not in pairs[0]]
        notes = (
            (f"2 of {len(others) + 2} files used; the others are {some(others)}",) if others else ()
        )
        eyes = {(0, col): name for col, name in enumerate(pairs[0])}
        by_name = "/" not in pairs[0][0] or side_of(pairs[0][0]) is not None
        return files_source(
            NAME,
            listing,
            eyes,
            (1, 2),
            turn=GridTransform() if by_name else None,
            turn_by="the names contain left and right" if by_name else "",
            notes=notes,
        )
    path = _alone(listing) or require_picture(listing)
    full = 255
    crossed = False
    more: dict[str, Any] = {}
    film = is_film(listing)
    header = None if film else open_header(path)
    if header is not None and header.eyes:
        views: list[NDArray[Any]] = list(read_frames(path, header.eyes))
        stated = header.eyes_sure or path.suffix.lower() == ".mpo"
        why = "the file defines which picture is the left eye's" * stated
    elif arrangement := _arrangement(path):
        if film:
            load, more = _filmed(path, arrangement)
            views = list(load(more["telling"]))
        else:
            picture, full = read_picture(path)
            views = _eyes(picture, arrangement)
        why = arrangement.why
        crossed = arrangement.crossed
        if min(views[0].shape[:2]) < MIN_VIEW_PX:
            height, width = views[0].shape[:2]
            raise UserError(
                f"{path}: two views of {width}x{height} px are too small to show anything",
                "export it in its full size",
            )
    else:
        raise UserError(
            f"{path}: its halves are not a stereo pair, neither side by side nor one above the"
            " other",
            "give two files x_left.png and x_right.png",
        )
    return SceneSource(
        certain=bool(why),
        layout=NAME,
        path=listing.path,
        files=(path,),
        rows=1,
        cols=len(views),
        read=lambda frame, row, col: load(frame)[col] if film else views[col],
        height_px=views[0].shape[0],
        width_px=views[0].shape[1],
        max_value=full,
        turn=GridTransform(cols=crossed) if why else None,
        turn_by=why,
        **more,
    )
