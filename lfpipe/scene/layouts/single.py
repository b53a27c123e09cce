"""Scenes in one file: a picture, which is a light field of one view; an animation (GIF, WebP, AVIF)
or video whose frames are views along a line, as in a wigglegram, or of a grid; and pictures of
R x C tiles, one view each.

mosaic         one picture (an atlas, a contact sheet); also a quilt without its usual name
quilt          Looking Glass: ..._qsCOLSxROWS[aASPECT], from the bottom left to the right, then
               up: https://docs.lookingglassfactory.com/keyconcepts/quilts
mosaic-video   numbered mosaics in a folder (25 a second), or a video of mosaics
"""

import math
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import MAX_DECODING_BYTES, open_header, read_frames, read_picture
from lfpipe.scene.files import VIDEOS, Listing
from lfpipe.scene.layouts._grid import (
    described_run,
    files_source,
    misfit,
    named_views,
    parse_grid,
)
from lfpipe.scene.layouts._likeness import (
    are_frames,
    find_columns,
    find_tiles,
    is_anaglyph,
    plane_of,
)
from lfpipe.scene.layouts._names import ANAGLYPH, words
from lfpipe.scene.layouts._stated import unread_depth
from lfpipe.scene.layouts._tiles import (
    QUILT_NAME,
    is_film,
    last_picture,
    require_picture,
    single_picture,
    tiling,
)
from lfpipe.scene.source import GridTransform, Layout, SceneSource
from lfpipe.scene.video import USUAL_RATE_HZ, Video, second_stream, telling_frame

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
    given = grid is not None and math.prod(grid) == len(frames)
    if is_video and grid is not None and not given:  # of the tiles in each frame
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
    """The pictures of tiles, and a note if they are not frames of one video.

    Raises UserError if their sizes differ.
    """
    if layout != "mosaic-video":
        return [require_picture(listing)], ()
    paths = [listing.file(name) for name in listing.pictures()] or [require_picture(listing)]
    sizes = [open_header(path).size for path in paths]
    if len(paths) > 1 and (
        sizes[0] != sizes[1] or not are_frames(*(read_picture(path)[0] for path in paths[:2]))
    ):
        note = f"{len(paths)} unrelated pictures: using {paths[0].name}; to see another one, give"
        return paths[:1], (f"{note} its path",)
    for path, size in zip(paths, sizes, strict=True):
        if size != sizes[0]:
            raise UserError(
                f"{path}: has {size}, but {paths[0].name} has {sizes[0]}",
                "export it again with frames of one size",
            )
    return paths, ()


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
)
