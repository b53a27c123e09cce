"""Pictures of R x C tiles, one view each.

mosaic         one picture (an atlas, a contact sheet); also a quilt without its usual name
quilt          Looking Glass: ..._qsCOLSxROWS[aASPECT], from the bottom left to the right, then
               up: https://docs.lookingglassfactory.com/keyconcepts/quilts
mosaic-video   numbered mosaics in a folder (25 a second), or a video of mosaics
"""

from functools import partial
from pathlib import Path

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture
from lfpipe.scene.files import VIDEOS, Listing
from lfpipe.scene.layouts._grid import named_views
from lfpipe.scene.layouts._tiles import (
    QUILT_NAME,
    Tiling,
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
        first = Video(listing.file(listing.names[0])).read(0)
        path = listing.path
        tiles = find_tiles(first, f"{path.parent.name}/{path.stem}") is not None
        return 60 if tiles or are_a_pair(*halves(first, above=False)) else None
    pictures = listing.pictures()
    if len(pictures) < 2 or ((named := named_views(listing)) is not None and not named.runs):
        return None  # names with row and column count more than a look at a picture
    return 45 if _has_tiles(listing.file(pictures[0])) else None


def _is_video(listing: Listing) -> bool:
    return listing.is_file and listing.names[0].lower().endswith(VIDEOS)


def _frames(layout: str, listing: Listing) -> tuple[list[Path], tuple[str, ...]]:
    """The pictures of tiles, and a note where they are not frames of one video.

    Raises UserError where their sizes differ.
    """
    if layout != "mosaic-video":
        return [require_picture(listing)], ()
    paths = [listing.file(name) for name in listing.pictures()] or [require_picture(listing)]
    headers = [open_header(path) for path in paths]
    usual = headers[0].size
    if len(paths) > 1 and (
        (usual, headers[0].grey) != (headers[1].size, headers[1].grey)
        or likeness(*paths[:2]) <= 0.5
    ):
        return paths[:1], (
            (
                f"{len(paths)} unrelated pictures: showing {paths[0].name}; name another file to"
                " see it"
            ),
        )
    for path, header in zip(paths, headers, strict=True):
        if header.size != usual:
            raise UserError(
                f"{path}: has {header.size}, but {paths[0].name} has {usual}",
                "export it again with frames of one size",
            )
    return paths, ()


def _describe(layout: str, listing: Listing, scene: config.Scene) -> SceneSource:
    quilt = layout == "quilt"
    notes: tuple[str, ...] = ()
    if _is_video(listing):
        paths = [listing.file(listing.names[0])]
        video = Video(paths[0])
        load = last_picture(video.read)
        full = 255
        frames = video.frames
        rate_hz = video.rate_hz
    else:
        paths, notes = _frames(layout, listing)
        load = last_picture(lambda frame: read_picture(paths[frame])[0])
        full = open_header(paths[0]).max_value
        frames = len(paths)
        rate_hz = USUAL_RATE_HZ if len(paths) > 1 else 0.0
    cut = tiling(load(0), paths[0], scene, quilt)
    if cut is None and are_a_pair(*halves(load(0), above=False)):
        cut = Tiling.even(load(0), 1, 2)
    if cut is None:
        height, width = load(0).shape[:2]
        remedy = "give the tiles with --set scene.grid=ROWSxCOLS"
        if _is_video(listing):
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
        height_px=cut.height_px,
        width_px=cut.width_px,
        max_value=full,
        doubt=cut.doubt,
        # without its name, or the user's word, nothing says where a quilt begins
        turn=Turn() if quilt else None,
        turn_by="a quilt runs from the leftmost camera" if quilt else "",
        notes=notes,
    )


LAYOUTS = (
    Layout("mosaic", partial(_detect_picture, "mosaic"), partial(_describe, "mosaic")),
    Layout("quilt", partial(_detect_picture, "quilt"), partial(_describe, "quilt")),
    Layout("mosaic-video", _detect_video, partial(_describe, "mosaic-video")),
)
