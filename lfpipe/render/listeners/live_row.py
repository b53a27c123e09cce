"""What a live scene adds to presentations: its age, whether disparity is of its own frame, and the
viewpoints for the stage that measures disparity and for the program that draws the scene.
"""

from lfpipe.render.live_input import LiveInput
from lfpipe.render.presenter import REPLACED, Listener, Presentation
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.ring_io import RingOutput
from lfpipe.transport.status import Row


class LiveRow(Listener):
    """Reports the live scene of presentations."""

    def __init__(self, row: Row, source: LiveInput, viewer: Viewer, viewpoints: RingOutput) -> None:
        """row: of the stage. viewpoints: of dtype VIEWPOINTS."""
        self._row = row
        self._source = source
        self._viewer = viewer
        self._viewpoints = viewpoints

    def handed_over(self, presentation: Presentation) -> None:
        stamp = self._source.stamp
        if stamp is None:
            return
        own = self._source.own_disparity
        presentation.more |= {"t_views_ns": stamp.t_sensor_ns, "own_disparity": own}
        self._row["live"] += presentation.composed
        self._row["own_disparity"] += presentation.composed and own
        record = self._viewpoints.begin()
        record["left"], record["right"] = presentation.viewpoints[1:3]
        record["left_mm"], record["right_mm"] = self._viewer.eyes_mm()
        self._viewpoints.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns)

    def presented(self, presentation: Presentation) -> None:
        t_views_ns = presentation.more.get("t_views_ns")
        if t_views_ns is not None and presentation.composed and presentation.by != REPLACED:
            age_ns = presentation.t_presented_ns - t_views_ns
            self._row.histograms["views_age"].add_ns(max(age_ns, 0))
