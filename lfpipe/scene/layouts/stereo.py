"""A stereo pair: two files (left and right, Middlebury's im2 and im6), one picture or video of both
(side by side, above one another, .jps, .mpo, a spatial photo in HEIC), or a video of two streams.
Two views, left eye first.

What a JPEG says decides, whatever its ending: the index of its pictures (CIPA DC-007, usually
.mpo), or a descriptor (VRex's format, usually .jps; without it, the right eye's half comes first).
"""

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
from lfpipe.scene.files import VIDEOS, Listing, list_scene
from lfpipe.scene.layouts._folders import inner_listing
from lfpipe.scene.layouts._grid import files_source, some
from lfpipe.scene.layouts._likeness import MIN_VIEW_PX, are_a_pair
from lfpipe.scene.layouts._names import (
    ABOVE,
    BESIDE,
    CROSSED,
    HALF,
    NUMBERED_PAIRS,
    camera_of,
    eye_pairs,
    is_map,
    read_names,
    side_of,
    words,
)
from lfpipe.scene.layouts._stated import Halves, contained, described
from lfpipe.scene.layouts._tiles import (
    halves,
    is_film,
    last_picture,
    require_picture,
    single_picture,
)
from lfpipe.scene.source import GridTransform, SceneSource
from lfpipe.scene.video import USUAL_RATE_HZ, Video, second_stream, stream_count, telling_frame

NAME = "stereo"
WORDS = {"beside": BESIDE, "above": ABOVE}  # of the arrangements that names state


def _pairs(listing: Listing) -> list[tuple[str, str]]:
    """The names of left and right pictures of a folder."""
    pairs = eye_pairs([name for name in listing.pictures() if not is_map(name)])
    names = tuple(left for left, _ in pairs)
    # two grids of cameras, left and right, are not an album of pairs; two folders are
    grid = read_names(names) if len(pairs) > 3 and "/" not in names[0] else None
    return [] if grid is not None and not grid.runs else pairs


def _around(listing: Listing) -> Listing:
    """The pair of which the left picture was given, by the words of its name or of its folder; else
    the listing.
    """
    if not listing.is_file or is_film(listing):
        return listing
    own = listing.folder
    places = [own] if side_of(listing.names[0]) else []
    places += [own.parent] if side_of(own.name) or camera_of(own.name) else []
    for folder in places:
        with suppress(UserError):
            around = list_scene(folder)
            around = around if folder == own else inner_listing(around) or around
            name = listing.path.relative_to(folder).as_posix()
            for pair in eye_pairs(around.pictures()):
                if pair[0] == name:
                    return attrs.evolve(around, path=listing.path, folder=folder, names=pair)
    return listing


def _alone(listing: Listing) -> Path | None:
    """The only file of the scene that may contain both pictures."""
    if is_film(listing):
        return listing.file(listing.names[0])
    names = [name for name in listing.pictures() if name.lower().endswith((".jps", ".mpo"))]
    return listing.file(names[0]) if len(names) == 1 else single_picture(listing)


def _looks(path: Path) -> list[NDArray[Any]]:
    """The picture at path; of a video, a frame that shows something, and of its second stream."""
    if not path.name.lower().endswith(VIDEOS):
        return [read_picture(path)[0]]
    number, picture = telling_frame(path)
    if stream_count(path) > 1 and find_spec("av"):
        with suppress(UserError):  # a stream that is declared and not there
            return [picture, Video(path, 1).rgb(number)]
    return [picture]


@lru_cache(maxsize=2)
def _arrangement(path: Path) -> Halves | None:
    """The arrangement of the picture at path: as the file states it, else as its name does, if its
    halves are alike; None if it does not contain two views. Raises UserError.
    """
    film = path.name.lower().endswith(VIDEOS)
    text = words(path.name)
    crossed, squeezed = bool(CROSSED.search(text)), bool(HALF.search(text))
    if not film and (descriptor := open_header(path).jps) is not None:
        return described(path, descriptor)
    if film and (stated := contained(path)):
        named = {form for form, table in WORDS.items() if table.search(text)}
        other = named and (stated.form not in named or stated.crossed != crossed)
        note = f"its name says otherwise: {stated.why}, which counts" if other else ""
        return attrs.evolve(stated, squeezed=squeezed, note=note)
    why = "by name or format, the right eye's picture comes first"
    if path.suffix.lower() == ".jps":
        return Halves(squeezed=squeezed, crossed=True, why=why)
    picture, *second = _looks(path)
    if second and second[0].shape == picture.shape and are_a_pair(picture, second[0]):
        return Halves(mark=55, streams=True)
    aspect = picture.shape[1] / picture.shape[0]
    for form, likely in (("beside", aspect > 1.2), ("above", aspect < 1.0)):
        by_name = bool(WORDS[form].search(text))
        if (by_name or likely) and are_a_pair(*halves(picture, form == "above")):
            begins = "the name states a format that begins with the left eye's picture" * by_name
            return Halves(
                form=form,
                squeezed=squeezed,
                crossed=crossed,
                why=why if crossed else begins,
                # the halves of a mosaic are alike, too: unless the name says so, tiles come first
                mark=65 if by_name else 55,
            )
    return None


def _eyes(picture: NDArray[Any], arrangement: Halves) -> list[NDArray[Any]]:
    """The two views of a picture."""
    form = arrangement.form
    lines = picture[::2]
    views = {
        "lines": (lines, picture[1::2]),
        "columns": (picture[:, ::2], picture[:, 1::2]),
        "checks": (lines[:, ::2], lines[:, 1::2]),
    }.get(form) or halves(picture, form == "above")
    if form == "checks" or (form in WORDS and not arrangement.squeezed):
        return [np.ascontiguousarray(view) for view in views]
    x, y = (1, 2) if form in ("above", "lines") else (2, 1)
    return [
        np.asarray(cv2.resize(view, None, fx=x, fy=y, interpolation=cv2.INTER_LINEAR))
        for view in views
    ]


def _filmed(
    path: Path, arrangement: Halves
) -> tuple[Callable[[int], NDArray[Any]], dict[str, Any]]:
    """(both views by frame, fields of SceneSource) of a video. Raises UserError."""
    video = Video(path)
    both = [video, Video(path, 1)] if arrangement.streams else [video]

    def load(frame: int) -> NDArray[Any]:
        pictures = [one.rgb(frame) for one in both]
        return np.stack(pictures if arrangement.streams else _eyes(pictures[0], arrangement))

    return last_picture(load), {
        "frames": min(one.frames for one in both),
        "frame_rate_hz": video.rate_hz or USUAL_RATE_HZ,
        "telling": telling_frame(path)[0],
        "notes": (
            *filter(None, [arrangement.note]),
            *(() if arrangement.streams else second_stream(path)),
        ),
    }


def detect(listing: Listing) -> int | None:
    listing = _around(listing)
    if pairs := _pairs(listing):
        paired = {name for pair in pairs for name in pair}
        others = [name for name in listing.pictures() if name not in paired and not is_map(name)]
        numbered = words(pairs[0][0]).strip() in NUMBERED_PAIRS
        if not others or numbered or "/" in pairs[0][0]:
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
    listing = _around(listing)
    if pairs := _pairs(listing):
        others = [name for name in listing.pictures() if name not in pairs[0]]
        notes = [f"2 of {len(others) + 2} files used; the others are {some(others)}"][: len(others)]
        if len(pairs) > 1:
            notes.append(f"`lfpipe up` shows all {len(pairs)} pairs, one after the other")
        eyes = {(0, col): name for col, name in enumerate(pairs[0])}
        by_name = "/" not in pairs[0][0] or side_of(pairs[0][0]) is not None
        return files_source(
            NAME,
            listing,
            eyes,
            (1, 2),
            turn=GridTransform() if by_name else None,
            turn_by="the names contain left and right" if by_name else "",
            notes=tuple(notes),
            playlist=tuple(listing.file(left) for left, _ in pairs),
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
