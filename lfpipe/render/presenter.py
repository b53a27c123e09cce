"""Puts pictures on the display: takes the newest eyes, composes only changes, and records what was shown.

What does not change the next picture happens after the hand-over: counts, reports, trace.
"""

import time
from collections import deque

import numpy as np
from numpy.typing import NDArray

from lfpipe.eyes import EYES, MAX_HORIZON_S, EyesRecord
from lfpipe.render.compositor import Key
from lfpipe.render.display import Display
from lfpipe.render.glasses import glasses_test
from lfpipe.render.motion_latency import MotionLatency
from lfpipe.render.mouse_look import MouseLook
from lfpipe.render.outputs import Outputs
from lfpipe.render.refresh import COST_SHARE, Refresh, ScreenRefresh
from lfpipe.render.showing import ANSWER_NS, HANDOVER, REPLACED, Showing, take_known
from lfpipe.render.viewer import VIDEO_LEAD, Viewer
from lfpipe.transport.clock import MS_NS, now_ns, sleep_until
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Stamp

STALE_NS = 500 * MS_NS  # a record so old comes from a tracker that has died, unless
STALE_FRAMES = 3  # frames come so slowly that it is younger than this many of their intervals
HORIZON_NS = int(MAX_HORIZON_S * 1e9)


class Presenter:
    """One display's pictures. picture: the last one, for a screenshot. refresh: the display's clock, None with one picture per
    camera frame. mouse: the viewer without a camera, or while the right button is held.
    tests_glasses: shows their test, not the scene."""

    def __init__(self, context: Context, viewer: Viewer, display: Display) -> None:
        self._context, self._viewer, self._display = context, viewer, display
        self._eyes = context.input("eyes")
        self._buffer = np.empty((), EYES)
        self._record: EyesRecord | None = None
        self._stamp: Stamp | None = None
        self._stale_ns = STALE_NS
        self._t_taken_ns = 0
        self._pending = False  # no picture was made yet for the newest record
        self._key: Key | None = None
        self._outputs = Outputs(context, viewer)
        self._waiting: deque[Showing] = deque()  # between hand-over and light
        self._latency: MotionLatency | None = (
            None  # where pictures become light after a known delay
        )
        self._loop_ns = 0
        self._number = 0
        self.refresh: Refresh | None = None
        self.cost_ns = 0  # running mean of composing and showing a picture
        self.mouse = MouseLook(
            context.config, viewer, context.output("eyes") if context.options.mouse else None
        )
        viewer.neutral_is_fixed |= bool(context.options.eyes)
        self.picture: NDArray[np.uint8] | None = None
        self.tests_glasses = False
        self.follow()

    def redraw(self) -> None:
        """Composes the next picture even if its key is unchanged."""
        self._key = None

    def follow(self) -> None:
        """Takes over changed options and configuration."""
        options = self._context.options
        self._outputs.follow(options, self.picture)
        # a file has no light, and without a clock replay.latency_ms is the whole delay
        lit = not options.lossless and not options.display.startswith("file:")
        self._loop_ns = int(self._viewer.config.render.loop_ms * 1e6) * lit
        if not self._loop_ns or options.display == "none":
            self._latency = None
        elif self._latency is None:
            self._latency = MotionLatency()

    def take(self) -> Stamp | None:
        """Reads the newest eyes record if there is one; returns its stamp."""
        stamp = self._eyes.take(self._buffer)
        if stamp is None or self._context.options.mouse:  # then the mouse wrote it, in this process
            return None
        if self._pending:
            self.leave_out()
        self._pending = True
        if self._stamp is not None and stamp.epoch == self._stamp.epoch:
            self._stale_ns = max(
                STALE_NS, STALE_FRAMES * (stamp.t_sensor_ns - self._stamp.t_sensor_ns)
            )
        self._record, self._stamp, self._t_taken_ns = EyesRecord.of(self._buffer), stamp, now_ns()
        return stamp

    def leave_out(self) -> None:
        """Counts the previous record as skipped if no picture was made for it: a newer one came, or the session is paused."""
        self._context.row["left_out"] += self._pending
        self._pending = False

    def show(self, target_ns: int, refresh_ns: int = 0) -> None:
        """Shows the picture for target_ns. refresh_ns: target_ns is a refresh of the display, with the next so much later.

        A picture that stays for a refresh is made for the middle of it, where the error over its time is least.
        """
        t_started_ns = now_ns()
        self._pending = False
        viewer, refresh = self._viewer, self.refresh
        seen_ns = target_ns + self._loop_ns + refresh_ns // 2
        record, stamp = self._record, self._stamp
        t_sensor_ns = stamp.t_sensor_ns if stamp else t_started_ns
        if self.mouse.looks:
            (record, stamp), t_sensor_ns = (
                self.mouse.eyes(record, stamp, t_started_ns),
                t_started_ns,
            )
        elif (
            record is not None
            and t_started_ns - t_sensor_ns > self._stale_ns
            and not self._context.options.lossless
        ):
            record, t_sensor_ns = (
                record._replace(face=0),
                t_started_ns,
            )  # the tracker died or hangs: nobody is seen
        on_blanks = isinstance(refresh, ScreenRefresh)
        viewer.video_lead_ns = round(VIDEO_LEAD * refresh_ns) if on_blanks else 0
        viewpoints = viewer.viewpoints(record, t_sensor_ns, seen_ns)
        key = viewer.compositor.key(viewpoints.left, viewpoints.right, viewpoints.frame)
        composed = key != self._key or not refresh_ns  # the paper draws for every camera frame
        pair = None
        if composed:
            self._key, self.picture, pair = key, viewer.compositor.draw(key), viewer.compositor.pair
            if self.tests_glasses:
                self.picture, pair = glasses_test(
                    viewer.config.render, (viewer.field.width_px, viewer.field.height_px)
                )
        t_composed_ns = now_ns()
        if refresh is not None and refresh_ns:
            sleep_until(refresh.earliest_ns(target_ns))
        t_handed_ns, cost_ns = now_ns(), 0
        if composed and self.picture is not None:
            t_handing_ns, cpu_ns = t_handed_ns, time.process_time_ns() if on_blanks else 0
            t_handed_ns = self._display.show(self.picture, pair, viewer.config.render.anaglyph)
            handing_ns = t_handed_ns - t_handing_ns
            if on_blanks:  # a swap may wait for the screen, which is not work
                handing_ns = min(handing_ns, time.process_time_ns() - cpu_ns)
            cost_ns = t_composed_ns - t_started_ns + handing_ns
            self._number += 1
        showing = Showing(
            self._number if composed else 0, None if record is None else stamp, record, viewpoints, self._context.row["seq"],
            target_ns if refresh_ns else 0, seen_ns, self._loop_ns, t_sensor_ns, t_started_ns, t_composed_ns, t_handed_ns,
            max(self._t_taken_ns - stamp.t_publish_ns, 0) if stamp else 0, cost_ns,
        )  # fmt: skip
        self._account(showing)

    def _account(self, showing: Showing) -> None:
        """Counts and reports after the hand-over, and what is known of the display without its reports."""
        row, stamp, refresh, composed, face = (
            self._context.row,
            showing.stamp,
            self.refresh,
            showing.number > 0,
            showing.face,
        )
        if self._latency is not None and showing.record is not None and not self.mouse.looks:
            self._latency.measured(showing.t_sensor_ns, showing.record.raw_px if face else None)
        if composed:
            self.cost_ns += int(COST_SHARE * (showing.cost_ns - self.cost_ns))
            if refresh is not None:
                refresh.took(showing.cost_ns, showing.t_started_ns, showing.target_ns)
        row.tick(stamp.source_seq if stamp else -1)
        row["cpu_ns"] = time.process_time_ns()
        if stamp is not None:
            row["face"] = face
            if face:
                row["t_face_ns"] = showing.t_started_ns
                row.horizon.add_ns(min(showing.seen_ns - showing.t_sensor_ns, HORIZON_NS))
            if self._outputs.traced:
                self._eyes.done()
        self._outputs.handed_over(showing, self.picture)
        if not self._display.blanks_by:
            showing.t_presented_ns = showing.t_handed_ns
            self._report(showing)
        else:
            row["planned"] += bool(showing.target_ns)
            if not composed:
                showing.t_presented_ns, showing.by = (
                    showing.target_ns or showing.t_handed_ns,
                    self._display.blanks_by,
                )
            self._waiting.append(showing)

    def _report(self, showing: Showing) -> None:
        """Counts and traces a picture whose time of display is known."""
        row, stamp, composed, t_ns = (
            self._context.row,
            showing.stamp,
            showing.number > 0,
            showing.t_presented_ns,
        )
        seen = showing.by != REPLACED
        if (
            composed
            and showing.target_ns
            and showing.by not in ("", HANDOVER)
            and isinstance(self.refresh, ScreenRefresh)
        ):
            row["juddered"] += self.refresh.judge(showing.target_ns, showing.t_handed_ns, t_ns)
        if stamp is None:
            return
        if composed:
            row.measure(
                showing.waited_ns, showing.cost_ns, t_ns - showing.t_sensor_ns if seen else None
            )
        if self._latency is not None and seen and composed and showing.face:
            after_ns = showing.seen_ns - (showing.target_ns or showing.t_handed_ns)
            self._latency.pictured(t_ns, after_ns, showing.loop_ns, showing.viewpoints.eyes_px)
            row["onset_ns"], row["steady_ns"] = self._latency.onset_ns, self._latency.steady_ns
        self._outputs.presented(showing, stamp)

    def missed(self, count: int) -> None:
        """Counts refreshes that passed with no new picture begun: the previous one stayed."""
        row = self._context.row
        row["missed"] += count
        if self._display.blanks_by:
            row["planned"] += count
            row["juddered"] += count

    def follow_screen(self) -> None:
        """Processes the window system's reports of pictures and blanks."""
        answers = self._display.presented()
        if answers and isinstance(self.refresh, ScreenRefresh):
            self.refresh.blanks(answers, self._display.nominal_hz())
        for showing in take_known(self._waiting, answers, self._display.blanks_by, now_ns()):
            self._report(showing)

    def close(self) -> None:
        """Ends the outputs."""
        for showing in take_known(
            self._waiting, (), self._display.blanks_by, now_ns() + 2 * ANSWER_NS
        ):
            self._report(showing)
        self._outputs.close()
