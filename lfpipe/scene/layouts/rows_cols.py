"""Picture files whose names hold row and column: any two of their numbers that span a grid."""

from lfpipe import config
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._views import describe_views, named_views
from lfpipe.scene.source import SceneSource

NAME = "rows-cols"


def detect(listing: Listing) -> int | None:
    numbered = named_views(listing)
    return 50 if numbered is not None and not numbered.runs else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    return describe_views(NAME, listing, scene, runs=False)
