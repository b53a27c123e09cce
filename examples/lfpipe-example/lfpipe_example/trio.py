"""A layout: three pictures, left.png, middle.png and right.png."""

from lfpipe import config
from lfpipe.scene.layouts._grid import files_source
from lfpipe.scene.source import Listing, SceneSource

NAME = "trio"
NAMES = ["left.png", "middle.png", "right.png"]


def detect(listing: Listing) -> int | None:
    return 60 if not listing.is_file and set(NAMES) <= set(listing.names) else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    views = {(0, col): name for col, name in enumerate(NAMES)}
    return files_source(NAME, listing, views, (1, 3))  # refuses links that leave the folder
