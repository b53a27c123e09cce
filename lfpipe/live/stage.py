"""Disparity: maps of the views that the viewer needs, for each frame of a live light field.

Reads: ring "views", the newest frame; ring "viewpoints", the newest; of a program that draws the
scene, its own ring, which may know the disparity.
Writes: ring "disparity", one record for each frame that it had time for.
Commands: stop; a lower rate and a faster estimator by option "level".
Emits: alignment (rotation of the right camera).
"""

import contextlib
import time

import numpy as np
from numpy.typing import NDArray

from lfpipe.live.field import SURE_FRAMES, Estimator
from lfpipe.live.records import VIEWPOINTS, Program, pairs_in_need, two_cameras, views_of
from lfpipe.transport import ring
from lfpipe.transport.context import Context
from lfpipe.transport.ring import SECOND_NS, Stamp, now_ns

REPORT_NS = 5 * SECOND_NS  # between two reports of the alignment


class DisparityStage:
    """Measures disparity, or takes that of the program that draws the scene."""

    def __init__(self, context: Context) -> None:
        live = context.options.live
        assert live is not None
        self._context = context
        self._live = live
        self._views = context.input("views")
        self._viewpoints = ring.Reader(context.spec.session.segment("viewpoints"))  # wakes nobody
        self._output = context.output("disparity")
        self._program = Program(live) if live.drawn else None
        self._estimator = Estimator(live, aligns=two_cameras(live))
        self._at = np.zeros((), VIEWPOINTS)
        self._at["left"] = self._at["right"] = (live.rows - 1) / 2, (live.cols - 1) / 2
        self._reported_ns = 0

    def run(self) -> None:
        """Runs until the stop command."""
        context = self._context
        while context.wait():
            context.ack_config()
            peeked = self._views.peek()
            if peeked is not None and not context.paused:
                self._measure(*peeked)

    def _measure(self, stamp: Stamp, frame: NDArray[np.uint8]) -> None:
        context = self._context
        lowered = context.options.level.disparity if context.options.level else 0
        if lowered and stamp.source_seq % 2:
            context.row["left_out"] += 1
            return
        t_begin_ns = now_ns()
        disparity = self._disparity(stamp, frame, coarse=lowered > 1)
        if not self._views.still_valid(stamp):
            return
        self._output.begin()[...] = disparity
        self._output.publish(
            stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
        )
        t_ns = now_ns()
        context.row.count_output(stamp.source_seq)
        context.row.record_latency(
            t_begin_ns - stamp.t_publish_ns, t_ns - t_begin_ns, t_ns - stamp.t_sensor_ns
        )
        context.row["cpu_ns"] = time.process_time_ns()
        self._report(t_ns)

    def _disparity(self, stamp: Stamp, frame: NDArray[np.uint8], coarse: bool) -> NDArray[np.void]:
        fresh = self._viewpoints.read(self._at) is not None
        context = self._context
        pairs = pairs_in_need(self._live, [self._at[eye].tolist() for eye in ("left", "right")])
        if self._program is not None:
            if fresh:
                self._program.send_viewpoints(self._at)
            if (drawn := self._program.disparity(stamp, views_of(pairs))) is not None:
                return drawn
        before = self._estimator.swapped
        estimate = self._estimator.estimate(frame, pairs, coarse)
        if self._estimator.strange_frames == SURE_FRAMES:
            context.notify("the views do not show one scene: check the cameras, layout and grid")
        if self._estimator.swapped != before:
            context.notify("the two cameras stand the other way round: views swapped")
        return estimate

    def _report(self, t_ns: int) -> None:
        aligned = self._estimator.alignment
        if aligned is not None and t_ns - self._reported_ns > REPORT_NS:
            self._reported_ns = t_ns
            placed = aligned.placement(self._estimator.swapped)
            self._context.emit("alignment", rotation_deg=round(placed.rotation_deg, 2))

    def close(self) -> None:
        """Closes the rings that the context does not know."""
        self._viewpoints.close()
        if self._program is not None:
            self._program.close()


def main(context: Context) -> None:
    """Runs the stage until it is stopped."""
    with contextlib.closing(DisparityStage(context)) as stage:
        context.ready()
        stage.run()
