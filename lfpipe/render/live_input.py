"""Frames of a live light field, from the rings "views" and "disparity" to the light field on show.

A frame is shown when its disparity is there; if that takes longer than LATE_FRAMES, it is shown
with the disparity of the frame before, cross-faded where the picture has changed.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.live.field import LiveViews
from lfpipe.live.records import View, disparity_dtype, pairs_in_need, views_of
from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.scene.lightfield import LightField
from lfpipe.transport.context import Context
from lfpipe.transport.ring import SECOND_NS, Stamp

LATE_FRAMES = 2.5  # frame intervals
STORED_FRAMES = 5  # the newest: disparity may be as late
MANY_VIEWS = 9  # of larger grids, only the views in need are taken from a frame
SHARE = 0.1  # of an interval in their running mean


class LiveInput:
    """The newest frame of a live light field."""

    def __init__(self, context: Context, live: LiveSource, name: str) -> None:
        self._live = live
        self._views = context.input("views")
        self._disparity = context.input("disparity")
        self.store = LiveViews(live, name)
        """Has the light field on show."""
        self.stamp: Stamp | None = None
        """Of its views."""
        self.own_disparity = False
        """Whether its disparity was measured in its views."""
        width_px, height_px = live.frame_px
        self._spare = np.empty((height_px, width_px, 3), np.uint8)
        self._frames: list[tuple[Stamp, NDArray[np.uint8]]] = []  # of all views, the newest last
        self._record = np.zeros((), disparity_dtype(live))
        self._interval_ns = SECOND_NS / 30  # of frames, until some were read

    def read(self, positions: Iterable[Position], t_ns: int) -> LightField | None:
        """Reads both rings; returns the light field if a newer one is to be shown. positions: the
        viewpoints (row, col) that are likely next.
        """
        stamp = self._disparity.take(self._record)
        self._read_views()  # second: the frame that the disparity was measured in is there
        measured = stamp and (stamp.epoch, stamp.source_seq)
        for frame, picture in self._frames:
            if measured != (frame.epoch, frame.source_seq):
                continue
            if self.stamp is None or frame.seq >= self.stamp.seq:
                self.store.show(picture, self._in_need(positions), self._record, frame.t_sensor_ns)
                return self._showing(frame, own_disparity=True)
            # for frames after it
            self.store.measure(picture, self._record, frame.t_sensor_ns)
        waiting = [one for one in self._frames if self.stamp is None or one[0].seq > self.stamp.seq]
        # once one was late, the next ones are not waited for
        late = self.stamp is not None and not self.own_disparity
        limit_ns = LATE_FRAMES * self._interval_ns
        if waiting and (late or t_ns - waiting[0][0].t_publish_ns > limit_ns):
            frame, picture = waiting[-1]
            self.store.show_with_last(picture, self._in_need(positions))
            return self._showing(frame, own_disparity=False)
        return None

    def _read_views(self) -> None:
        stamp = self._views.take(self._spare)
        if stamp is None:
            return
        if self._frames and self._frames[-1][0].epoch == stamp.epoch:
            passed_ns = stamp.t_sensor_ns - self._frames[-1][0].t_sensor_ns
            self._interval_ns += SHARE * (min(passed_ns, SECOND_NS) - self._interval_ns)
        self._frames.append((stamp, self._spare))
        self._spare = (
            self._frames.pop(0)[1]
            if len(self._frames) > STORED_FRAMES
            else np.empty_like(self._spare)
        )

    def _showing(self, stamp: Stamp, own_disparity: bool) -> LightField:
        self.stamp, self.own_disparity = stamp, own_disparity
        return self.store.field

    def _in_need(self, positions: Iterable[Position]) -> list[View]:
        """The views to take from a frame: all of a small grid, else those around the viewpoints and
        one further on.
        """
        live = self._live
        if live.rows * live.cols <= MANY_VIEWS:
            return list(np.ndindex(live.rows, live.cols))
        rows, cols = zip(*views_of(pairs_in_need(live, positions)), strict=True)
        return [
            (row, col)
            for row in range(max(min(rows) - 1, 0), min(max(rows) + 2, live.rows))
            for col in range(max(min(cols) - 1, 0), min(max(cols) + 2, live.cols))
        ]
