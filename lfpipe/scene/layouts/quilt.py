"""Looking Glass quilts: one picture named ..._qsCOLSxROWS[aASPECT], leftmost camera at the bottom left, then right, then up.

Format: https://docs.lookingglassfactory.com/keyconcepts/quilts.
"""

import re

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import read_picture
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import parse_grid
from lfpipe.scene.layouts._tiles import UNEVEN, Tiling, find_tiles, picture_loader, single_picture
from lfpipe.scene.source import SceneSource, Turn

NAME = "quilt"
_NAME = re.compile(r"_qs(\d{1,2})x(\d{1,2})(?:a[\d.]+)?", re.IGNORECASE)


def detect(listing: Listing) -> int | None:
    path = single_picture(listing)
    return 95 if path is not None and _NAME.search(path.stem) else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = single_picture(listing)
    if path is None:
        raise UserError(f"{listing.path}: contains {len(listing.pictures())} pictures; a quilt is one", "give the picture itself")
    named, grid = _NAME.search(path.stem), parse_grid(scene.grid)
    if grid is None and named:
        grid = int(named[2]), int(named[1])
    picture, full = read_picture(path)
    if grid is None and (tiles := find_tiles(picture, path.stem)) is not None:
        grid = tiles.shape
    if grid is None:
        raise UserError(f"{path}: the name does not define the tiles (_qsCOLSxROWS)", "give them with --set scene.grid=ROWSxCOLS")
    height, width = picture.shape[:2]
    rows, cols = grid
    if rows * cols == 0 or ((height % rows or width % cols) and UNEVEN.get((width, height)) != (cols, rows)):
        raise UserError(
            f"{path}: {width}x{height} px do not divide into {cols} columns and {rows} rows of tiles",
            "the name says _qsCOLSxROWS; give the tiles that were rendered with --set scene.grid=ROWSxCOLS",
        )
    cut, load = Tiling.even(picture, rows, cols, quilt=True), picture_loader([path])
    return SceneSource(
        layout=NAME, path=listing.path, files=(path,), rows=1, cols=rows * cols,
        read=lambda frame, row, col: cut.cut(load(frame), row, col),
        height_px=cut.height_px, width_px=cut.width_px, max_value=full,
        turn=Turn(), turn_by="a quilt runs from the leftmost camera at the bottom left",
    )  # fmt: skip
