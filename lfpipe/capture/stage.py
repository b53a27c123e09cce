"""Capture: frames of a camera, a file or the demo into the ring.

Reads: the source in option "source".
Writes: ring "frames", one slot per frame, decoded in place; while a recording runs, ring "packets" with the original JPEGs.
Commands: stop; pause and resume by configuration (the stage still reads the source but drops frames).
Emits: source (what was opened), camera (lost, found), notice (the same for people).
State: READY, not RUNNING, while no camera delivers frames.
"""

import contextlib
import logging
import time
from collections import deque

from lfpipe.capture.frame_source import BrokenFrame, Frame, SourceInfo
from lfpipe.capture.open_source import open_source
from lfpipe.capture.reconnecting_camera import CameraLost
from lfpipe.capture.schedule import Lateness
from lfpipe.transport.clock import SleepWatch, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.packet_ring import PacketOutput
from lfpipe.transport.status import State

log = logging.getLogger(__name__)

LIGHT_FRAMES = 45  # 1.5 s at 30 Hz: their mean interval is the rate
DIM_SHARE, BRIGHT_SHARE = 0.8, 0.9  # of the negotiated rate
LATE_PERIODS = 2  # a camera's driver would have kept as many


class _LightWatch:
    """Detects that the camera delivers fewer frames than negotiated although none is lost: probably too little light."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.stamps: deque[int] = deque(maxlen=LIGHT_FRAMES)  # of consecutive frames

    def add(self, frame: Frame, info: SourceInfo, lost: int) -> None:
        """Adds a frame of a live source; lost: frames lost before it."""
        if lost:
            self.stamps.clear()
        self.stamps.append(frame.t_sensor_ns)
        if len(self.stamps) < LIGHT_FRAMES:
            return
        hz = 1e9 * (LIGHT_FRAMES - 1) / max(1, self.stamps[-1] - self.stamps[0])
        row, was = self._context.row, self._context.row["dim"]
        row["dim"] = hz < (BRIGHT_SHARE if was else DIM_SHARE) * info.rate_hz
        if row["dim"] and not was:
            text = f"{info.name} delivers {hz:.3g} instead of {info.rate_hz:.3g} Hz, probably because of too little light"
            self._context.emit("notice", text=text)


def _report(context: Context, info: SourceInfo) -> None:
    context.row["nominal_mhz"] = round(1000 * info.rate_hz)
    log.info(
        "source %s: %dx%d at %.4g Hz; %s",
        info.name,
        *info.size_px,
        info.rate_hz,
        "; ".join(info.notes),
    )
    context.emit(
        "source", name=info.name, rate_hz=info.rate_hz, live=info.live, notes=list(info.notes)
    )


def main(context: Context) -> None:
    """Runs the stage until it is stopped or the source ends."""
    frames, packets = context.output("frames"), PacketOutput(context.spec.session)
    with context.setting_up("opening the source"):
        source = open_source(context.options.source, context.config.camera, reconnect=True)
    info = source.info
    _report(context, info)
    lateness = Lateness(
        int(LATE_PERIODS * 1e9 / info.rate_hz)
        if info.rate_hz and not context.spec.options.lossless
        else 0
    )
    light, sleeps, lost_ns, broken, next_seq = _LightWatch(context), SleepWatch(), 0, 0, 0
    context.ready()
    try:
        if not info.live and not context.wait_for_others():
            return
        while context.wait(now_ns()):
            context.ack_config()
            if context.paused and context.options.lossless:
                context.wait()  # no clock drives this source: stop it
                continue
            t_begin_ns = now_ns()
            try:
                with (
                    contextlib.nullcontext()
                    if info.live
                    else context.busy_with("reading the recording")
                ):  # from a slow disk
                    frame = source.read(frames.begin())
            except CameraLost as lost:
                log.warning("camera lost: %s: %s", info.name, lost)
                context.row["state"], lost_ns = State.READY, now_ns()
                context.emit("camera", name=info.name, lost=True, why=str(lost))
                context.emit("notice", text=f"{lost}; camera lost, trying again")
                continue
            except TimeoutError:
                continue
            except BrokenFrame as error:
                broken += 1
                context.row["drops"] += 1
                if broken & (broken - 1) == 0:  # the 1st, 2nd, 4th, ...: a file may be full of them
                    context.emit(
                        "notice", text=error.message + (f" ({broken} so far)" if broken > 1 else "")
                    )
                continue
            if frame is None:
                return
            if lost_ns:
                context.row["state"], away_s, name = (
                    State.RUNNING,
                    (now_ns() - lost_ns) / 1e9,
                    source.info.name,
                )
                context.emit("camera", name=name, lost=False, away_s=away_s)
                context.emit("notice", text=f"{name} is back after {away_s:.1f} s")
                _report(context, source.info)
            if lost_ns or sleeps.woke():
                lost_ns = 0
                light.stamps.clear()
                frames.writer.new_epoch()  # the viewer may be anywhere by now: old positions mean nothing
            busy_ns, t_read_ns, t_sensor_ns = (
                now_ns() - t_begin_ns,
                frame.t_read_ns,
                frame.t_sensor_ns + lateness.moved_ns,
            )
            if not t_read_ns:
                while now_ns() < t_sensor_ns:
                    if not context.wait(t_sensor_ns):
                        return
                    context.ack_config()  # takes effect with this frame, not yet published
                t_read_ns = now_ns()
                if lateness.drops(frame.t_sensor_ns, t_read_ns):
                    context.row["drops"] += 1
                    continue
                t_sensor_ns = frame.t_sensor_ns + lateness.moved_ns
            else:
                busy_ns = now_ns() - t_read_ns
            if info.live:
                missing, next_seq = frame.source_seq - next_seq, frame.source_seq + 1
                context.row["drops"] += missing
                light.add(frame, source.info, missing)
            if context.paused:
                context.row["left_out"] += 1
                continue
            packets.follow(context.options)
            packets.publish(
                frame.packet, frame.source_seq, t_sensor_ns, t_read_ns, frames.writer.epoch
            )
            frames.publish(frame.source_seq, t_sensor_ns, t_read_ns, kind=frame.stamp)
            t_ns = now_ns()
            context.row.tick(frame.source_seq)
            context.row.measure(t_read_ns - t_sensor_ns, busy_ns, t_ns - t_sensor_ns)
            context.row["cpu_ns"] = time.process_time_ns()
    finally:
        packets.close()
        source.close()
