"""Frames of a live light field, from the rings "views" and "disparity" to the light field on show.

A frame is shown when its disparity is there; if that takes longer than LATE_FRAMES, it is shown
with the disparity of the frame before, cross-faded where the picture has changed.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.live.field import LiveViews
from lfpipe.live.records import View, disparity_dtype, views_in_need
from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.scene.lightfield import LightField
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Stamp

LATE_FRAMES = 2.5  # frame intervals
KEPT_FRAMES = 3  # that wait for their disparity
MANY_VIEWS = 9  # of larger grids, only the views in need are taken from a frame
USUAL_HZ = 30.0  # of a source that does not know its rate


class _Waiting(NamedTuple):
    """A frame."""

    stamp: Stamp
    frame: NDArray[np.uint8]


class LiveInput:
    """The newest frame of a live light field."""

    def __init__(self, context: Context, live: LiveSource, name: str) -> None:
        self._live = live
        self._views = context.input("views")
        self._disparity = context.input("disparity")
        self._store = LiveViews(live, name)
        self.field = self._store.field
        """The light field on show."""
        self.stamp: Stamp | None = None
        """Of its views."""
        self.own_disparity = False
        """Whether its disparity was measured in its views."""
        width_px, height_px = live.frame_px
        self._free = [np.empty((height_px, width_px, 3), np.uint8) for _ in range(KEPT_FRAMES + 2)]
        self._waiting: list[_Waiting] = []
        self._shown: _Waiting | None = None
        self._record = np.zeros((), disparity_dtype(live))
        self._late_ns = int(LATE_FRAMES * SECOND_NS / (live.rate_hz or USUAL_HZ))

    def take(self, positions: Iterable[Position], t_ns: int) -> LightField | None:
        """Reads both rings; returns the light field if a newer one is to be shown. positions: the
        viewpoints (row, col) that are likely next.
        """
        self._take_views()
        stamp = self._disparity.take(self._record)
        if stamp is not None:
            number = stamp.epoch, stamp.source_seq
            for k, waiting in enumerate(self._waiting):
                if (waiting.stamp.epoch, waiting.stamp.source_seq) == number:
                    views = self._in_need(positions)
                    self._store.show(waiting.frame, views, self._record, t_ns)
                    return self._showing(k, own_disparity=True)
        if self._waiting and t_ns - self._waiting[0].stamp.t_publish_ns > self._late_ns:
            newest = self._waiting[-1].frame
            last = self._shown.frame if self._shown else newest
            self._store.show_with_last(newest, last, self._in_need(positions))
            return self._showing(len(self._waiting) - 1, own_disparity=False)
        return None

    def _take_views(self) -> None:
        if len(self._waiting) == KEPT_FRAMES:
            self._free.append(self._waiting.pop(0).frame)
        stamp = self._views.take(self._free[-1])
        if stamp is not None:
            self._waiting.append(_Waiting(stamp, self._free.pop()))

    def _showing(self, k: int, own_disparity: bool) -> LightField:
        """Keeps frame k of those that wait, and frees those before it."""
        if self._shown is not None:
            self._free.append(self._shown.frame)
        self._free += [waiting.frame for waiting in self._waiting[:k]]
        self._shown = self._waiting[k]
        del self._waiting[: k + 1]
        self.stamp = self._shown.stamp
        self.own_disparity = own_disparity
        self.field = self._store.field
        return self.field

    def _in_need(self, positions: Iterable[Position]) -> list[View]:
        """The views to take from a frame: all of a small grid, else those around the viewpoints and
        one further on.
        """
        live = self._live
        if live.rows * live.cols <= MANY_VIEWS:
            return list(np.ndindex(live.rows, live.cols))
        near = views_in_need(live, positions)
        rows = [view[0] for view in near]
        cols = [view[1] for view in near]
        return [
            (row, col)
            for row in range(max(min(rows) - 1, 0), min(max(rows) + 2, live.rows))
            for col in range(max(min(cols) - 1, 0), min(max(cols) + 2, live.cols))
        ]
