"""The program that draws a live scene: its disparity, and the viewpoints that it may draw for."""

import contextlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.errors import UserError
from lfpipe.live.records import View, disparity_record, eye_views
from lfpipe.live.shared_scene import MAX_SIDE_VIEWS, RING, attached, viewpoints_of
from lfpipe.transport import ring
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.ring import Stamp

RETRY_NS = SECOND_NS  # between two tries to find its ring again


class Program:
    """The rings of a live scene, whose program may end and start again."""

    def __init__(self, live: LiveSource) -> None:
        """live: of such a scene."""
        self._live = live
        self._name = live.source.removeprefix(RING)
        self._reader: ring.Reader | None = None
        self._viewpoints: ring.Writer | None = None
        self._tried_ns = 0
        self._attach()

    def _attach(self) -> None:
        self.close()
        self._tried_ns = now_ns()
        with contextlib.suppress(UserError, FileNotFoundError):
            self._reader, grid, size_px = attached(self._name)
            live = self._live
            if (*grid, *size_px) != (live.rows, live.cols, live.width_px, live.height_px):
                self.close()  # it came back with other views, which cannot be shown

    def tell(self, at: NDArray[np.void]) -> None:
        """Gives it the viewpoints of the next picture, of dtype VIEWPOINTS."""
        if self._viewpoints is None and self._reader is not None:
            with contextlib.suppress(UserError, FileNotFoundError):
                self._viewpoints = ring.Writer(viewpoints_of(self._name))
        if self._viewpoints is not None:
            self._viewpoints.begin()[...] = at
            self._viewpoints.publish(0, now_ns(), 0)

    def found(self, stamp: Stamp, views: Iterable[View]) -> NDArray[np.void] | None:
        """Its disparity of views of a frame; None if it gives none, or what no program means."""
        reader = self._reader
        taken = reader.find(stamp.t_sensor_ns) if reader is not None else None
        if reader is None or taken is None:
            if now_ns() - self._tried_ns > RETRY_NS:
                self._attach()
            return None
        slot, record = taken  # in shared memory
        live = self._live
        step_px, positions = float(record["step_px"]), np.array(record["positions"])
        # NaN is none
        if not 0 < step_px <= live.width_px or (np.abs(positions) > MAX_SIDE_VIEWS).any():
            return None
        if np.isfinite(positions).all():
            views = eye_views(live)
        maps = {view: np.array(record["maps"][view]) for view in views}
        found = disparity_record(live, maps, step_px)
        found["positions"] = positions
        return found if reader.still_valid(slot) else None

    def close(self) -> None:
        """Closes the rings."""
        for part in (self._reader, self._viewpoints):
            if part is not None:
                part.close()
        self._reader = self._viewpoints = None
