"""One picture of R x C tiles, one view each (an atlas, a contact sheet); also a Looking Glass quilt without its usual name."""

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import read_picture
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._tiles import find_tiles, picture_loader, single_picture, tiling
from lfpipe.scene.source import SceneSource, Turn

NAME = "mosaic"


def detect(listing: Listing) -> int | None:
    path = single_picture(listing)
    if path is None:
        return None
    try:
        picture, _ = read_picture(path)
    except UserError:
        return None
    return 60 if find_tiles(picture, f"{path.parent.name}/{path.stem}") else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = single_picture(listing)
    if path is None:
        raise UserError(f"{listing.path}: contains {len(listing.pictures())} pictures; a mosaic is one", "give one picture")
    picture, full = read_picture(path)
    cut = tiling(picture, path, scene)
    if cut is None:
        what = f"{path}: no tiles recognised in {picture.shape[1]}x{picture.shape[0]} px"
        raise UserError(what, "give them with --set scene.grid=ROWSxCOLS")
    load = picture_loader([path])
    return SceneSource(
        certain=False, layout=NAME, path=listing.path, files=(path,), rows=cut.grid[0], cols=cut.grid[1],
        read=lambda frame, row, col: cut.cut(load(frame), row, col),
        height_px=cut.height_px, width_px=cut.width_px, max_value=full,
        doubt=cut.doubt, turn=Turn() if cut.quilt else None, turn_firm=False,
        turn_by="a quilt runs from the leftmost camera" if cut.quilt else "",
    )  # fmt: skip
