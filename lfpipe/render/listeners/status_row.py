"""Figures of the pictures in the stage's row of the status table."""

import time

from lfpipe.eyes import MAX_HORIZON_S
from lfpipe.render.display.display import Display
from lfpipe.render.presentation import REPLACED, Listener, Showing
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.status import Row

HORIZON_NS = int(MAX_HORIZON_S * 1e9)


class StatusRow(Listener):
    """Counts showings in the stage's row of the status table, and measures them."""

    def __init__(self, row: Row, viewer: Viewer, display: Display) -> None:
        self._row = row
        self._viewer = viewer
        self._display = display

    def handed_over(self, showing: Showing) -> None:
        row = self._row
        eyes = showing.eyes
        row.tick(eyes.stamp.source_seq if eyes else -1)
        row["cpu_ns"] = time.process_time_ns()
        row["planned"] += bool(showing.due_ns and self._display.blanks_by)
        if eyes is None:
            return
        row["viewer"] = int(self._viewer.presence.state)
        row["face"] = showing.face
        if showing.face:
            row["t_face_ns"] = showing.t_started_ns
            row.horizon.add_ns(min(showing.moment.seen_ns - eyes.t_ns, HORIZON_NS))

    def missed(self, count: int) -> None:
        """Counts refreshes that passed with no new picture begun: the previous one stayed."""
        self._row["missed"] += count
        if self._display.blanks_by:
            self._row["planned"] += count
            self._row["juddered"] += count

    def presented(self, showing: Showing) -> None:
        self._row["juddered"] += showing.juddered
        eyes = showing.eyes
        if eyes is not None and showing.composed:
            age_ns = showing.t_presented_ns - eyes.t_ns if showing.by != REPLACED else None
            self._row.measure(eyes.waited_ns, showing.cost_ns, age_ns)
