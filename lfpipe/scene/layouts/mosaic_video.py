"""Light-field video: numbered mosaics in a folder (25 a second), or a video file whose every frame is a mosaic."""

from pathlib import Path

import numpy as np

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture
from lfpipe.scene.files import VIDEOS, Listing
from lfpipe.scene.layouts._tiles import LastPictures, find_tiles, glance, picture_loader, tiling
from lfpipe.scene.layouts._views import named_views
from lfpipe.scene.layouts.stereo import are_a_pair
from lfpipe.scene.source import SceneSource, Turn
from lfpipe.scene.video import USUAL_RATE_HZ, Video

NAME = "mosaic-video"


def _is_video(listing: Listing) -> bool:
    return listing.is_file and listing.names[0].lower().endswith(VIDEOS)


def detect(listing: Listing) -> int | None:
    if _is_video(listing):
        return 60
    pictures = listing.pictures()
    if listing.is_file or len(pictures) < 2 or ((named := named_views(listing)) is not None and not named.runs):
        return None  # names with row and column count more than a look at a picture
    try:
        first, _ = read_picture(listing.file(pictures[0]))
    except UserError:
        return None
    return 45 if find_tiles(first, Path(pictures[0]).stem) else None


def _alike(a: Path, b: Path) -> bool:
    """Whether two pictures can be frames of one video. Raises UserError."""
    if len({(header.width_px, header.height_px, header.grey) for header in (open_header(a), open_header(b))}) > 1:
        return False
    return float(np.corrcoef(glance(a).ravel(), glance(b).ravel())[0, 1]) > 0.5


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    notes: tuple[str, ...] = ()
    if _is_video(listing):
        paths = [listing.file(listing.names[0])]
        video = Video(paths[0])
        frames, rate, full = video.about.frames, video.about.rate_hz, 255
        load = LastPictures(video.read)
    else:
        paths = [listing.file(name) for name in listing.pictures()]
        if not paths:
            raise UserError(f"{listing.path}: no pictures", "give a folder of numbered mosaics, or a video of mosaics")
        full = open_header(paths[0]).max_value
        if len(paths) > 1 and not _alike(paths[0], paths[1]):
            notes = (f"{len(paths)} unrelated pictures: showing {paths[0].name}; name another file to see it",)
            paths = paths[:1]
        frames, rate = len(paths), USUAL_RATE_HZ if len(paths) > 1 else 0.0
        load = picture_loader(paths)
    first = load(0)
    cut = tiling(first, paths[0], scene)
    if cut is None:
        remedy = "give the tiles with --grid ROWSxCOLS; from a camera slid sideways, `lfpipe scene make` makes views"
        half_px = first.shape[1] // 2
        if are_a_pair(first[:, :half_px], first[:, half_px : 2 * half_px]):
            remedy = "give --grid 1x2: its halves are a stereo pair"
        raise UserError(f"{paths[0]}: its first frame is not a mosaic of views", remedy)
    return SceneSource(
        certain=False, layout=NAME, path=listing.path, files=tuple(paths), rows=cut.grid[0], cols=cut.grid[1],
        read=lambda frame, row, col: cut.cut(load(frame), row, col),
        height_px=cut.height_px, width_px=cut.width_px, max_value=full, frames=frames, frame_rate_hz=rate,
        doubt=cut.doubt, turn=Turn() if cut.quilt else None, turn_firm=False,
        turn_by="a quilt runs from the leftmost camera" if cut.quilt else "", notes=notes,
    )  # fmt: skip
