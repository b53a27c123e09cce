"""Views: frames with all views of a live light field, into the ring of views.

Reads: the source in option "live".
Writes: ring "views", one slot per frame, decoded in place.
Commands and messages: those of `lfpipe.capture.stage`, which does the work.
"""

from lfpipe.capture.live_source import live_camera
from lfpipe.capture.stage import CaptureStage, run
from lfpipe.transport.context import Context


def main(context: Context) -> None:
    """Runs the stage until it is stopped or the source ends."""
    live = context.options.live
    assert live is not None
    camera = live_camera(context.config, live.frame_px)
    run(CaptureStage(context, live.source, camera, "views"), context)
