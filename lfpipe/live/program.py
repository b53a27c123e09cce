"""The program that draws a live scene: its disparity, and the viewpoints that it may draw for; the
recording of one.
"""

import contextlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.errors import UserError
from lfpipe.live.estimator import Found
from lfpipe.live.records import View, eye_views
from lfpipe.live.shared_scene import MAX_SIDE_VIEWS, RING, attached, viewpoints_of
from lfpipe.sequence.views import Known, open_views
from lfpipe.transport import ring
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.ring import Stamp

RETRY_NS = SECOND_NS  # between two tries to find its ring again


def _found(known: Known, live: LiveSource, views: Iterable[View]) -> Found | None:
    """Copies of the maps of views; None if it holds what no program means."""
    step_px, positions = known.step_px, known.positions
    # NaN is none
    if not 0 < step_px <= live.width_px or (np.abs(positions) > MAX_SIDE_VIEWS).any():
        return None
    if known.of_eyes:
        views = eye_views(live)
    maps = {(row, col): np.array(known.maps[row * live.cols + col]) for row, col in views}
    return Found.of(maps, step_px, positions)


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

    def found(self, stamp: Stamp, views: Iterable[View]) -> Found | None:
        """Its disparity of views of a frame; None if it gives none."""
        if (taken := self._known(stamp)) is None:
            return None
        slot, known = taken
        found = _found(known, self._live, views)
        return found if self._reader is not None and self._reader.still_valid(slot) else None

    def packed(self, stamp: Stamp) -> bytes:
        """All that it knows of a frame, for a recording; b"" if it gives no disparity."""
        if (taken := self._known(stamp)) is None:
            return b""
        slot, known = taken
        packed = known.packed() if known.step_px else b""
        return packed if self._reader is not None and self._reader.still_valid(slot) else b""

    def _known(self, stamp: Stamp) -> tuple[Stamp, Known] | None:
        """What is in the slot of a frame, in shared memory."""
        taken = self._reader.find(stamp.t_sensor_ns) if self._reader is not None else None
        if taken is None:
            if now_ns() - self._tried_ns > RETRY_NS:
                self._attach()
            return None
        slot, record = taken
        maps = record["maps"].reshape(-1, *record["maps"].shape[2:])
        return slot, Known(float(record["step_px"]), np.array(record["positions"]), maps)

    def close(self) -> None:
        """Closes the rings."""
        for part in (self._reader, self._viewpoints):
            if part is not None:
                part.close()
        self._reader = self._viewpoints = None


class RecordedProgram:
    """What a program knew of a recorded scene."""

    def __init__(self, live: LiveSource) -> None:
        """live: of `open_views`."""
        self._live = live
        opened = open_views(Path(live.source).parent, verify=False)
        assert opened is not None
        self._sequence = opened[0]

    def tell(self, at: NDArray[np.void]) -> None:
        """Nobody draws."""

    def found(self, stamp: Stamp, views: Iterable[View]) -> Found | None:
        """See `Program.found`. Raises UserError if the recording is damaged."""
        known = Known.of(self._sequence, self._live, stamp.source_seq)
        return None if known is None else _found(known, self._live, views)

    def close(self) -> None:
        """Nothing to do."""
