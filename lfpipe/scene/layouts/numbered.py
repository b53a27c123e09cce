"""Pictures with a running number: a grid row by row, column by column or as a snake, or a line of views.

The names do not say which; the pictures decide, because neighbouring views look alike.
"""

from lfpipe import config
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._views import describe_views, named_views
from lfpipe.scene.source import SceneSource

NAME = "numbered"


def detect(listing: Listing) -> int | None:
    numbered = named_views(listing)
    return 40 if numbered is not None and numbered.runs else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    return describe_views(NAME, listing, scene, runs=True)
