"""Pictures of R x C tiles, one view each.

mosaic         one picture (an atlas, a contact sheet); also a quilt without its usual name
quilt          Looking Glass: ..._qsCOLSxROWS[aASPECT], leftmost camera at the bottom left, then right, then up:
               https://docs.lookingglassfactory.com/keyconcepts/quilts
mosaic-video   numbered mosaics in a folder (25 a second), or a video file whose every frame is a mosaic
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture
from lfpipe.scene.files import VIDEOS, Listing
from lfpipe.scene.layouts._grid import named_views
from lfpipe.scene.layouts._tiles import (
    QUILT_NAME,
    find_tiles,
    halves,
    last_picture,
    likeness,
    require_picture,
    single_picture,
    tiling,
)
from lfpipe.scene.layouts.stereo import are_a_pair
from lfpipe.scene.source import Layout, SceneSource, Turn
from lfpipe.scene.video import USUAL_RATE_HZ, Video


def _has_tiles(path: Path) -> bool:
    return find_tiles(read_picture(path)[0], f"{path.parent.name}/{path.stem}") is not None


def _detect_picture(layout: str, listing: Listing) -> int | None:
    path = single_picture(listing)
    if path is None or layout == "quilt":
        return 95 if path is not None and QUILT_NAME.search(path.stem) else None
    return 60 if _has_tiles(path) else None


def _detect_video(listing: Listing) -> int | None:
    if _is_video(listing):
        return 60
    pictures = listing.pictures()
    if len(pictures) < 2 or ((named := named_views(listing)) is not None and not named.runs):
        return None  # names with row and column count more than a look at a picture
    return 45 if _has_tiles(listing.file(pictures[0])) else None


def _is_video(listing: Listing) -> bool:
    return listing.is_file and listing.names[0].lower().endswith(VIDEOS)


def _describe_picture(layout: str, listing: Listing, scene: config.Scene) -> SceneSource:
    path = require_picture(listing)
    return _source(layout, listing, scene, [path], *_pictures([path]))


def _pictures(paths: list[Path]) -> tuple[Callable[[int], NDArray[Any]], int]:
    """Pictures by frame number, and their full value. Raises UserError if they differ in size."""
    first = open_header(paths[0])
    for path in paths[1:]:
        if (size := open_header(path).size) != first.size:
            what = f"{path}: {size}, {paths[0].name} has {first.size}"
            raise UserError(what, "all frames of a light-field video must have the same size")
    return last_picture(lambda frame: read_picture(paths[frame])[0]), first.max_value


def _source(
    layout: str, listing: Listing, scene: config.Scene, paths: list[Path], load: Callable[[int], NDArray[Any]], full: int,
    **more: Any,
) -> SceneSource:  # fmt: skip
    """The views of pictures of tiles. load: a picture by frame; more: further fields of SceneSource. Raises UserError."""
    quilt = layout == "quilt"
    cut = tiling(load(0), paths[0], scene, quilt)
    if cut is None:
        height, width = load(0).shape[:2]
        remedy = "give the tiles with --grid ROWSxCOLS"
        if are_a_pair(*halves(load(0), above=False)):
            remedy = "give --grid 1x2: its halves are a stereo pair"
        elif _is_video(listing):
            remedy += "; from a camera slid sideways, `lfpipe scene make` makes views"
        raise UserError(f"{paths[0]}: no tiles recognised in {width}x{height} px", remedy)
    return SceneSource(
        certain=quilt, layout=layout, path=listing.path, files=tuple(paths), rows=cut.grid[0], cols=cut.grid[1],
        read=lambda frame, row, col: cut.cut(load(frame), row, col),
        height_px=cut.height_px, width_px=cut.width_px, max_value=full, doubt=cut.doubt, turn=Turn() if cut.quilt else None,
        turn_firm=quilt, turn_by="a quilt runs from the leftmost camera" if cut.quilt else "", **more,
    )  # fmt: skip


def _are_frames(a: Path, b: Path) -> bool:
    """Whether two pictures can be frames of one video. Raises UserError."""
    if len({(header.width_px, header.height_px, header.grey) for header in (open_header(a), open_header(b))}) > 1:
        return False
    return likeness(a, b) > 0.5


def _describe_video(listing: Listing, scene: config.Scene) -> SceneSource:
    if _is_video(listing):
        paths = [listing.file(listing.names[0])]
        video = Video(paths[0])
        frames, rate = video.frames, video.rate_hz
        return _source("mosaic-video", listing, scene, paths, last_picture(video.read), 255, frames=frames, frame_rate_hz=rate)
    paths, notes = [listing.file(name) for name in listing.pictures()], []
    if not paths:
        raise UserError(f"{listing.path}: no pictures", "give a folder of numbered mosaics, or a video of mosaics")
    if len(paths) > 1 and not _are_frames(paths[0], paths[1]):
        notes.append(f"{len(paths)} unrelated pictures: showing {paths[0].name}; name another file to see it")
        paths = paths[:1]
    rate = USUAL_RATE_HZ if len(paths) > 1 else 0.0
    return _source(
        "mosaic-video", listing, scene, paths, *_pictures(paths), notes=tuple(notes), frames=len(paths), frame_rate_hz=rate
    )


LAYOUTS = (
    Layout("mosaic", partial(_detect_picture, "mosaic"), partial(_describe_picture, "mosaic")),
    Layout("quilt", partial(_detect_picture, "quilt"), partial(_describe_picture, "quilt")),
    Layout("mosaic-video", _detect_video, _describe_video),
)
