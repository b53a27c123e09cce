"""Disparity: maps of the views that the viewer needs, for each frame of a live light field.

Reads: ring "views", the newest frame; ring "viewpoints", the newest.
Writes: ring "disparity", one record for each frame that it had time for.
Commands: stop; a lower rate and a faster estimator by option "level".
Emits: alignment (rotation of the right camera).
"""

import logging
import time

import numpy as np

from lfpipe.config import LiveSource
from lfpipe.live.estimator import Estimator
from lfpipe.live.records import VIEWPOINTS, View, views_in_need
from lfpipe.transport import ring
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context

logger = logging.getLogger(__name__)
REPORT_NS = 5 * SECOND_NS  # between two reports of the alignment


def main(context: Context) -> None:
    """Runs the stage until it is stopped."""
    live = context.options.live
    assert live is not None
    views = context.input("views")
    viewpoints = ring.Reader(context.spec.session.segment("viewpoints"))  # wakes nobody
    output = context.output("disparity")
    # a mosaic of many views comes from one optical system, a pair from two
    estimator = Estimator(live, aligns=live.rows * live.cols == 2)
    needed = views_in_need(live, [((live.rows - 1) / 2, (live.cols - 1) / 2)])
    at = np.empty((), VIEWPOINTS)
    reported_ns = 0
    context.ready()
    while context.wait():
        context.ack_config()
        if viewpoints.read(at) is not None:
            needed = _needed(live, at)
        peeked = views.peek()
        if peeked is None or context.paused:
            continue
        stamp, frame = peeked
        lowered = context.options.level.disparity if context.options.level else 0
        if lowered and stamp.source_seq % 2:
            context.row["left_out"] += 1
            continue
        t_taken_ns = now_ns()
        maps = estimator.estimate(frame, needed, coarse=lowered > 1)
        if not views.still_valid(stamp):
            continue
        record = output.begin()
        record["count"] = len(maps)
        record["scale_px"] = estimator.step_px
        record["low_px"], record["high_px"] = estimator.range_px
        aligned = estimator.alignment
        record["align"] = np.eye(2, 3) if aligned is None else aligned.matrix
        for k, (view, disparity) in enumerate(maps.items()):
            record["views"][k] = view
            record["maps"][k] = disparity
        output.publish(
            stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
        )
        t_ns = now_ns()
        context.row.count_output(stamp.source_seq)
        context.row.record_latency(
            t_taken_ns - stamp.t_publish_ns, t_ns - t_taken_ns, t_ns - stamp.t_sensor_ns
        )
        context.row["cpu_ns"] = time.process_time_ns()
        if aligned is not None and t_ns - reported_ns > REPORT_NS:
            reported_ns = t_ns
            context.emit("alignment", rotation_deg=round(aligned.rotation_deg, 2))


def _needed(live: LiveSource, at: np.ndarray) -> list[View]:
    return views_in_need(live, [at["left"].tolist(), at["right"].tolist()])
