"""Capture: frames of a camera, a file or the demo into the ring. Views: the frames of a live light
field, with all its views.

Reads: the source in option "source"; for views, in option "live".
Writes: ring "frames" or "views", one slot per frame, decoded in place; recordings of frames, by the
original JPEGs where there are any.
Commands: record, stop; pause and resume by configuration: a recording stands still, and a camera is
read once a second, its frames dropped. While nobody looks, eight frames a second are published, and
a camera is read as often.
Emits: source (what was opened), camera (lost, found), notice (the same for people).
State: READY, not RUNNING, while no camera delivers frames.
"""

import contextlib
import logging
import time

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import Frame
from lfpipe.capture.open_source import (
    CameraLost,
    camera_settings,
    check_source,
    live_camera,
    open_source,
)
from lfpipe.capture.recordings import Lateness
from lfpipe.config import Camera
from lfpipe.config.session_options import Lossless, RecordedEyes
from lfpipe.errors import UserError
from lfpipe.files.codecs import BrokenFrame
from lfpipe.sequence.recorder import Recordable, Recorder
from lfpipe.transport.context import Context
from lfpipe.transport.ring import SECOND_NS, SleepWatch, now_ns
from lfpipe.transport.status import State

log = logging.getLogger(__name__)

LATE_PERIODS = 2  # a camera's driver would have kept as many
# between two frames of a camera while the session is paused, and while nobody looks
PAUSED_NS, IDLE_NS = SECOND_NS, SECOND_NS // 8
# standard deviation of a frame, in grey levels, below which it shows nothing: a covered sensor's
# noise has 1 to 3, a dark room with a face 6 and more
FLAT_LEVELS = 4.0
COVERED_NS = SECOND_NS  # a hand passes in less
EVERY_PX = 16  # of the pixels that are looked at


def flat_since(since_ns: int, frame: NDArray[np.uint8], t_ns: int) -> int:
    """Since when frames show nothing; 0 if the newest, uint8 (height, width, 3), shows something.

    since_ns: the same of the frame before.
    """
    flat = float(frame[::EVERY_PX, ::EVERY_PX, 1].std()) < FLAT_LEVELS
    return (since_ns or t_ns) if flat else 0


class CaptureStage:
    """Reads a source, and publishes its frames when they are due.

    source, camera: as for `open_source`. ring: for its frames. recorder: records them.
    """

    def __init__(
        self,
        context: Context,
        source: str,
        camera: Camera,
        ring: str,
        recorder: Recorder | None = None,
    ) -> None:
        self._context = context
        self._lossless = isinstance(context.options.clock, Lossless)
        self._frames = context.output(ring)
        self._recorder = recorder
        with context.setting_up("opening the source"):
            self._source = open_source(source, camera, reconnect=True)
        self._report_source()
        info = self._source.info
        self._live = info.live
        late_s = LATE_PERIODS / info.rate_hz if info.rate_hz and not self._lossless else 0.0
        self._lateness = Lateness(int(late_s * 1e9))
        self._flat_ns = 0
        self._sleeps = SleepWatch()
        self._lost_ns = 0  # since then there is no camera; 0: there is one
        self._broken = 0
        self._next_seq = 0
        self._is_viewers = ring == "frames"
        self._published_ns = 0
        self._rested = False  # whether the last frame was read while the session was idle
        self._ended = False

    def _report_source(self) -> None:
        info = self._source.info
        context = self._context
        context.row["nominal_mhz"] = round(1000 * info.rate_hz)
        notes = "; ".join(info.notes)
        log.info("source %s: %dx%d at %.4g Hz; %s", info.name, *info.size_px, info.rate_hz, notes)
        context.emit(
            "source", name=info.name, rate_hz=info.rate_hz, live=info.live, notes=list(info.notes)
        )

    def run(self) -> None:
        """Runs until the stop, or the end of the source."""
        context = self._context
        context.ready()
        if not self._live and not context.wait_for_others():
            return
        next_ns = 0  # when a frame is read
        while context.wait(next_ns) and not self._ended:
            self._execute_commands()
            t_begin_ns = now_ns()
            if context.paused and not self._live:
                self._stand_still()
                continue
            if t_begin_ns < next_ns and context.idle:
                continue  # woken by a message
            next_ns = t_begin_ns + self._rest_ns()
            frame = self._read()
            if frame is not None:
                # from the driver, or the disk, to the decoded picture
                self._publish(frame, now_ns() - (frame.t_read_ns or t_begin_ns))

    def _stand_still(self) -> None:
        """Stops a recording and its clock while the session is paused."""
        began_ns = now_ns()
        while self._context.paused and self._context.wait():
            self._execute_commands()
        if not self._lossless:
            self._lateness.moved_ns += now_ns() - began_ns

    def _rest_ns(self) -> int:
        """The time from one frame of a camera to the next one that is read, beyond its own."""
        if not self._live:
            return 0
        if self._context.paused:
            return PAUSED_NS
        return IDLE_NS if self._nobody_looks else 0

    @property
    def _nobody_looks(self) -> bool:
        return self._is_viewers and self._context.options.idle

    def _read(self) -> Frame | None:
        """The next frame, decoded into the ring's slot; None if none came."""
        context = self._context
        slow_disk = (
            contextlib.nullcontext() if self._live else context.busy_with("reading the recording")
        )
        frame = None
        try:
            with slow_disk:
                frame = self._source.read(self._frames.begin())
            self._ended = frame is None
        except CameraLost as lost:
            name = self._source.info.name
            log.warning("camera lost: %s: %s", name, lost)
            context.row["state"] = State.READY
            self._lost_ns = now_ns()
            context.emit("camera", name=name, lost=True, why=str(lost))
            context.notify(f"{lost}; camera lost, trying again")
        except TimeoutError:
            pass
        except BrokenFrame as error:
            self._broken += 1
            context.row["drops"] += 1
            if self._broken.bit_count() == 1:  # the 1st, 2nd, 4th, ...: a file may be full of them
                so_far = f" ({self._broken} so far)" if self._broken > 1 else ""
                context.notify(error.message + so_far)
        return frame

    def _publish(self, frame: Frame, busy_ns: int) -> None:
        """Publishes a frame when it is due, unless it is late or the session is paused. busy_ns: of
        reading it.
        """
        self._note_gap()
        context = self._context
        t_sensor_ns = frame.t_sensor_ns + self._lateness.moved_ns
        spare = self._nobody_looks and t_sensor_ns < self._published_ns + IDLE_NS
        if spare and not self._live:
            context.row["left_out"] += 1  # the one that follows is waited for
            return
        t_read_ns = frame.t_read_ns or self._wait_until_due(frame)
        if not t_read_ns:
            return
        frames = self._frames
        picture = frames.begin()
        t_sensor_ns = frame.t_sensor_ns + self._lateness.moved_ns
        stale = False
        if self._live:
            lost = frame.source_seq - self._next_seq
            self._next_seq = frame.source_seq + 1
            context.row["left_out" if self._rested else "drops"] += lost
            stale = self._rested and not context.idle  # the driver kept it
            self._rested = context.idle
        if context.paused or stale or spare:
            context.row["left_out"] += 1
        else:
            self._published_ns = t_sensor_ns
            frames.publish(frame.source_seq, t_sensor_ns, t_read_ns, kind=frame.stamp)
            t_ns = now_ns()
            context.row.count_output(frame.source_seq)
            context.row.record_latency(t_read_ns - t_sensor_ns, busy_ns, t_ns - t_sensor_ns)
            context.row["cpu_ns"] = time.process_time_ns()
            context.row["offset_us"] = frame.offset_ns // 1000
            if self._recorder is not None and self._recorder.active:
                jpeg = frame.packet  # the source's own, if it delivers them
                self._recorder.add(
                    Recordable(
                        source_seq=frame.source_seq,
                        epoch=frames.writer.epoch,
                        t_sensor_ns=t_sensor_ns,
                        t_read_ns=t_read_ns,
                        data=picture.copy() if jpeg is None else jpeg.tobytes(),
                        codec="" if jpeg is None else "jpeg",
                    ),
                    wait=self._lossless,
                )
        # after publishing, which it would delay
        self._flat_ns = flat_since(self._flat_ns, picture, frame.t_sensor_ns)
        context.row["covered"] = 0 < self._flat_ns <= frame.t_sensor_ns - COVERED_NS

    def _execute_commands(self) -> None:
        """Executes commands, and follows the recording."""
        context = self._context
        context.ack_config()
        if self._recorder is None:
            return
        for word, message in context.commands() if context.news else ():
            if word == "record":
                self._recorder.handle(message)
        self._recorder.report()

    def _note_gap(self) -> None:
        """Begins a new epoch after a gap: the viewer may be anywhere by now, and old positions mean
        nothing.
        """
        if self._lost_ns:
            self._context.row["state"] = State.RUNNING
            away_s = (now_ns() - self._lost_ns) / 1e9
            name = self._source.info.name
            self._context.emit("camera", name=name, lost=False, away_s=away_s)
            self._context.notify(f"{name} is back after {away_s:.1f} s")
            self._report_source()
        if self._lost_ns or self._sleeps.woke():
            self._lost_ns = 0
            self._frames.writer.new_epoch()

    def _wait_until_due(self, frame: Frame) -> int:
        """Waits for a recording's clock; returns the time, 0 for a late frame and at the stop."""
        context = self._context
        while now_ns() < (due_ns := frame.t_sensor_ns + self._lateness.moved_ns):
            if not context.wait(due_ns):
                return 0
            context.ack_config()  # takes effect with this frame, not yet published
        t_ns = now_ns()
        if self._lateness.drops(frame.t_sensor_ns, t_ns):
            context.row["drops"] += 1
            return 0
        return t_ns

    def close(self) -> None:
        """Closes the source, and completes a recording."""
        self._source.close()
        if self._recorder is not None:
            self._recorder.close()


def main(context: Context) -> None:
    """Runs the stage until it is stopped or the source ends."""
    if context.spec.name == "views" and (live := context.options.live) is not None:
        camera = live_camera(context.config, live.frame_px)
        stage = CaptureStage(context, live.source, camera, "views")
    else:
        camera = camera_settings(context.config)
        source = context.options.viewer.source
        if context.spec.request:  # another viewer, while the session runs
            with context.setting_up("opening the source"):
                replacement = check_source(source, camera)
            if isinstance(replacement, RecordedEyes):
                raise UserError(
                    f"{source}: a recording of the mouse cannot replace a viewer",
                    "start a session with --camera",
                )
            source = replacement.source
            context.answer({"number": context.spec.request}, **attrs.asdict(replacement))
        frame_px = context.options.viewer.jpeg_px or context.config.camera.frame_px
        stage = CaptureStage(context, source, camera, "frames", Recorder(context, frame_px))
    with contextlib.closing(stage):
        stage.run()
