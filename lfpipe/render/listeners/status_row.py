"""Metrics of pictures in the stage's row of the status table."""

import time

from lfpipe.eyes import MAX_PREDICTION_S
from lfpipe.render.display.display import Display
from lfpipe.render.presenter import REPLACED, Listener, Presentation
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.status import Row

MAX_PREDICTION_NS = int(MAX_PREDICTION_S * SECOND_NS)


class StatusRow(Listener):
    """Counts and measures presentations in the stage's row of the status table."""

    def __init__(self, row: Row, viewer: Viewer, display: Display) -> None:
        self._row = row
        self._viewer = viewer
        self._display = display

    def handed_over(self, presentation: Presentation) -> None:
        row = self._row
        eyes = presentation.eyes
        row.count_output(eyes.stamp.source_seq if eyes else -1)
        row["cpu_ns"] = time.process_time_ns()
        row["planned"] += bool(presentation.due_ns and self._display.vblank_source)
        if eyes is None:
            return
        row["viewer"] = int(self._viewer.presence.state)
        row["face"] = presentation.face
        if presentation.face:
            row["t_face_ns"] = presentation.t_started_ns
            row.histograms["prediction"].add_ns(
                min(presentation.display_time.seen_ns - eyes.t_ns, MAX_PREDICTION_NS)
            )

    def missed(self, count: int) -> None:
        """Counts refreshes without a new picture that was due."""
        self._row["missed"] += count
        if self._display.vblank_source:
            self._row["planned"] += count
            self._row["juddered"] += count

    def presented(self, presentation: Presentation) -> None:
        self._row["juddered"] += presentation.juddered
        eyes = presentation.eyes
        if eyes is not None and presentation.composed:
            age_ns = (
                presentation.t_presented_ns - eyes.t_ns if presentation.by != REPLACED else None
            )
            self._row.record_latency(eyes.waited_ns, presentation.cost_ns, age_ns)
