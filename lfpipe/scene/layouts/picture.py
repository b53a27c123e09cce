"""A single picture: a light field of one view."""

from __future__ import annotations

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import PICTURES, Listing, read_picture
from lfpipe.scene.layouts._grid import files_source
from lfpipe.scene.layouts._mosaic import single_picture
from lfpipe.scene.source import SceneSource, Turn

NAME = "picture"


def detect(listing: Listing) -> int | None:
    return 10 if single_picture(listing) is not None else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = single_picture(listing)
    if path is None:
        count = len(listing.pictures())
        raise UserError(f"{listing.path}: holds {count} pictures, not one", f"give one file ({', '.join(PICTURES)})")
    read_picture(path)
    return files_source(NAME, listing, {(0, 0): path}, 1, 1, turn=Turn(), turn_by="there is one view")
