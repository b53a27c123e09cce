"""Capture: frames of a camera, a file or the demo into the ring.

Reads: the source named by option "source".
Writes: ring "frames", one slot per frame, decoded in place.
Commands: stop; pause and resume by configuration (frames go on being taken and are thrown away).
Emits: source (what was opened), stalled (a device gave nothing for a second).
"""

from __future__ import annotations

import time

from lfpipe.capture.open_source import open_source
from lfpipe.transport.clock import now_ns
from lfpipe.transport.context import Context

LATE_PERIODS = 2  # as many frames as a camera's driver would have kept for us


def main(context: Context) -> None:
    """Runs the stage until the stop or the end of the source."""
    frames = context.output("frames")
    source = open_source(context.options["source"], context.config.camera)
    info = source.info
    context.emit("source", name=info.name, rate_hz=info.rate_hz, live=info.live, notes=list(info.notes))
    late_ns = int(LATE_PERIODS * 1e9 / info.rate_hz) if info.rate_hz and not context.spec.lossless else 0
    context.ready()
    try:
        if not info.live and not context.wait_for_others():
            return
        while context.wait(now_ns()):
            context.applied()
            t_begin_ns = now_ns()
            try:
                frame = source.read(frames.begin())
            except TimeoutError as error:
                context.emit("stalled", why=str(error))
                continue
            if frame is None:
                return
            busy_ns, t_read_ns = now_ns() - t_begin_ns, frame.t_read_ns
            if not t_read_ns:
                while now_ns() < frame.t_sensor_ns:
                    if not context.wait(frame.t_sensor_ns):
                        return
                t_read_ns = now_ns()
                if late_ns and t_read_ns - frame.t_sensor_ns > late_ns:
                    context.row["drops"] += 1  # by now a camera would have overwritten it
                    continue
            else:
                busy_ns = now_ns() - t_read_ns
            if context.paused:
                continue
            frames.publish(frame.source_seq, frame.t_sensor_ns, t_read_ns)
            t_ns = now_ns()
            context.row.tick(frame.source_seq)
            context.row.measure(t_read_ns - frame.t_sensor_ns, busy_ns, t_ns - frame.t_sensor_ns)
            context.row["cpu_ns"] = time.process_time_ns()
    finally:
        source.close()
