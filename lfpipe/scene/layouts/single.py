"""Scenes in one file: a picture, which is a light field of one view; an animation (GIF, WebP, AVIF)
or video whose frames are views along a line, as in a wigglegram, or of a grid; pictures of R x C
tiles, one view each; and stereo pairs, also in two files.

mosaic         one picture (an atlas, a contact sheet); also a quilt without its usual name
quilt          Looking Glass: ..._qsCOLSxROWS[aASPECT], from the bottom left to the right, then
               up: https://docs.lookingglassfactory.com/keyconcepts/quilts
mosaic-video   numbered mosaics in a folder (25 a second), or a video of mosaics
stereo         two views, left eye first: two files (left and right, Middlebury's im2 and im6), one
               picture or video of both (side by side, above one another, .jps, .mpo, a spatial
               photo in HEIC), or a video of two streams. What a JPEG says decides, whatever its
               ending: the index of its pictures (CIPA DC-007, usually .mpo), or a descriptor
               (VRex's format, usually .jps; without it, the right eye's half comes first)
"""

import math
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import MAX_DECODING_BYTES, open_header, read_frames, read_picture
from lfpipe.scene.layouts._grid import (
    QUILT_NAME,
    described_run,
    files_source,
    halves,
    is_film,
    last_picture,
    misfit,
    named_views,
    parse_grid,
    require_picture,
    single_picture,
    some,
    tiling,
)
from lfpipe.scene.layouts._likeness import (
    MIN_VIEW_PX,
    are_a_pair,
    are_frames,
    find_columns,
    find_tiles,
    is_anaglyph,
    plane_of,
)
from lfpipe.scene.layouts._names import (
    ABOVE,
    ANAGLYPH,
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
from lfpipe.scene.layouts._stated import Halves, contained, described, unread_depth
from lfpipe.scene.layouts.named import inner_listing
from lfpipe.scene.source import VIDEOS, GridTransform, Layout, Listing, SceneSource, list_scene
from lfpipe.scene.video import USUAL_RATE_HZ, Video, second_stream, stream_count, telling_frame

_STILLS = ("JPEG", "TIFF", "HEIF")  # several pictures in one such file are no animation


def _describe_picture(listing: Listing, scene: config.Scene) -> SceneSource:
    path = require_picture(listing)
    notes = [note] if (note := unread_depth(path)) else []
    if ANAGLYPH.search(words(path.name)) or is_anaglyph(read_picture(path)[0]):
        notes.append(
            "this looks like a red/cyan anaglyph, which is shown flat: its colours do not give back"
            " the stereo pair"
        )
    return files_source(
        "picture",
        listing,
        {(0, 0): path.name},
        (1, 1),
        turn=GridTransform(),
        turn_by="there is one view",
        notes=tuple(notes),
    )


@lru_cache(maxsize=2)
def _animation(listing: Listing) -> Path | None:
    path = single_picture(listing)
    header = open_header(path) if path else None
    return path if header and header.frames > 1 and header.format not in _STILLS else None


def _frames(path: Path) -> list[NDArray[Any]]:
    """All frames of an animation or video. Raises UserError."""
    if not path.name.lower().endswith(VIDEOS):
        return list(read_frames(path))
    video = Video(path)
    if video.frames * video.height_px * video.width_px * 3 > MAX_DECODING_BYTES:
        raise UserError(
            f"{path}: {video.frames} frames of {video.width_px}x{video.height_px} px: no tiles are"
            " recognised in them, and they are too many for views",
            f"if the camera slid sideways, make views with `lfpipe scene make {path}`; give the"
            " frames of a grid as pictures in a folder",
        )
    return [video.rgb(frame) for frame in range(video.frames)]


def _describe_animation(listing: Listing, scene: config.Scene) -> SceneSource:
    is_video = is_film(listing)
    path = listing.file(listing.names[0]) if is_video else _animation(listing)
    path = path or require_picture(listing)
    frames = _frames(path)
    grid = parse_grid(scene.grid)
    fits_grid = grid is not None and math.prod(grid) == len(frames)
    if is_video and grid is not None and not fits_grid:  # of the tiles in each frame
        return _describe_tiles("mosaic-video", listing, scene)
    run = find_columns(lambda at: plane_of(frames[at]), [True] * len(frames), grid)
    if run is None:
        raise misfit(str(path), len(frames), grid)
    height, width = frames[0].shape[:2]
    if is_video and run.rows == 1 and scene.layout == "auto" and not grid:
        what = f"no tiles were recognised in {width}x{height} px, and its frames form no grid"
        raise UserError(
            "; ".join([f"{path}: {what}", *second_stream(path)]),
            f"if the camera slid sideways, make views with `lfpipe scene make {path}`; else give"
            " the tiles with --set scene.grid=ROWSxCOLS, or open the frames as one line with --set"
            " scene.layout=gif",
        )
    return SceneSource(
        certain=False,
        layout="gif",
        path=listing.path,
        files=(path,),
        rows=run.rows,
        cols=run.cols,
        read=lambda frame, row, col: frames[row * run.cols + col],
        height_px=height,
        width_px=width,
        doubt=run.doubt,
        notes=(described_run(run, grid),) if run.rows > 1 else (),
    )


def _detect_animation(listing: Listing) -> int | None:
    if is_film(listing):
        return 50  # an animation of tiles is more specific
    return None if _animation(listing) is None else 90


def _has_tiles(picture: NDArray[Any], path: Path) -> bool:
    return find_tiles(picture, f"{path.parent.name}/{path.stem}") is not None


def _detect_tiles(layout: str, listing: Listing) -> int | None:
    path = single_picture(listing)
    if path is None or layout == "quilt":
        return 95 if path is not None and QUILT_NAME.search(path.stem) else None
    return 60 if _has_tiles(read_picture(path)[0], path) else None


def _detect_mosaics(listing: Listing) -> int | None:
    if is_film(listing):
        return 60 if _has_tiles(telling_frame(listing.path)[1], listing.path) else None
    pictures = listing.pictures()
    if len(pictures) < 2 or ((named := named_views(listing)) is not None and not named.runs):
        return None  # names with row and column take precedence over picture content
    first_path = listing.file(pictures[0])
    return 45 if _has_tiles(read_picture(first_path)[0], first_path) else None


def _mosaics(layout: str, listing: Listing) -> tuple[list[Path], tuple[str, ...]]:
    """The pictures of tiles; the first alone, with a note, if they are not frames of one video."""
    if layout != "mosaic-video":
        return [require_picture(listing)], ()
    paths = [listing.file(name) for name in listing.pictures()] or [require_picture(listing)]
    sizes = [open_header(path).size for path in paths]
    if len(paths) == 1 or (
        len({*sizes}) == 1 and are_frames(*(read_picture(path)[0] for path in paths[:2]))
    ):
        return paths, ()
    return paths[:1], (
        f"{len(paths)} unrelated pictures: using {paths[0].name}; to see another one, give its"
        " path",
    )


def _describe_tiles(layout: str, listing: Listing, scene: config.Scene) -> SceneSource:
    quilt = layout == "quilt"
    notes: tuple[str, ...] = ()
    telling = 0
    if is_film(listing):
        paths = [listing.file(listing.names[0])]
        video = Video(paths[0])
        load = last_picture(video.rgb)
        full = 255
        frames = video.frames
        rate_hz = video.rate_hz or USUAL_RATE_HZ
        telling = telling_frame(paths[0])[0]
        notes = tuple(second_stream(paths[0]))
    else:
        paths, notes = _mosaics(layout, listing)
        load = last_picture(lambda frame: read_picture(paths[frame])[0])
        full = open_header(paths[0]).max_value
        frames = len(paths)
        rate_hz = USUAL_RATE_HZ if len(paths) > 1 else 0.0
    cut = tiling(load(telling), paths[0], scene, quilt)
    if cut is None:
        height, width = load(telling).shape[:2]
        remedy = "give the tiles with --set scene.grid=ROWSxCOLS"
        if is_film(listing):
            remedy += "; if the camera slid sideways, make views with `lfpipe scene make`"
        raise UserError(f"{paths[0]}: no tiles were recognised in {width}x{height} px", remedy)
    return SceneSource(
        certain=quilt,
        layout=layout,
        path=listing.path,
        files=tuple(paths),
        rows=cut.grid[0],
        cols=cut.grid[1],
        read=lambda frame, row, col: cut.cut(load(frame), row, col),
        frames=frames,
        frame_rate_hz=rate_hz,
        telling=telling,
        height_px=cut.height_px,
        width_px=cut.width_px,
        max_value=full,
        doubt=cut.doubt,
        # without its name or the user's setting, the first view of a quilt is unknown
        turn=GridTransform() if quilt else None,
        turn_by="a quilt runs from the leftmost camera" if quilt else "",
        notes=notes,
    )


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


def _detect_pair(listing: Listing) -> int | None:
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


def _describe_pair(listing: Listing, scene: config.Scene) -> SceneSource:
    listing = _around(listing)
    if pairs := _pairs(listing):
        others = [name for name in listing.pictures() if name not in pairs[0]]
        notes = [f"2 of {len(others) + 2} files used; the others are {some(others)}"][: len(others)]
        if len(pairs) > 1:
            notes.append(f"`lfpipe up` shows all {len(pairs)} pairs, one after the other")
        eyes = {(0, col): name for col, name in enumerate(pairs[0])}
        by_name = "/" not in pairs[0][0] or side_of(pairs[0][0]) is not None
        return files_source(
            "stereo",
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
        layout="stereo",
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


LAYOUTS = (
    Layout(
        "picture",
        lambda listing: None if single_picture(listing) is None else 10,
        _describe_picture,
    ),
    Layout("gif", _detect_animation, _describe_animation),
    Layout("mosaic", partial(_detect_tiles, "mosaic"), partial(_describe_tiles, "mosaic")),
    Layout("quilt", partial(_detect_tiles, "quilt"), partial(_describe_tiles, "quilt")),
    Layout("mosaic-video", _detect_mosaics, partial(_describe_tiles, "mosaic-video")),
    Layout("stereo", _detect_pair, _describe_pair),
)
