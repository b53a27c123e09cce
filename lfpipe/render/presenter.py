"""Puts pictures on the display: takes the newest eyes, composes only changes, stamps and traces what was shown."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.config.quality import level_number
from lfpipe.errors import UserError
from lfpipe.eyes import EYES, MAX_HORIZON_S
from lfpipe.files.trace import TraceFile
from lfpipe.render.display import Display
from lfpipe.render.glasses_test import GlassesTest
from lfpipe.render.motion_latency import MotionLatency
from lfpipe.render.outputs import OptionalOutputs, ViewerReports
from lfpipe.render.pair_layout import Pair
from lfpipe.render.refresh import LeadTime, ScreenClock
from lfpipe.render.shown_pictures import HANDOVER, REPLACED, ShownPictures
from lfpipe.render.viewer import VIDEO_LEAD, Viewer, Viewpoints
from lfpipe.transport.clock import MS_NS, now_ns, sleep_until
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Stamp
from lfpipe.transport.stamp_kind import StampKind

if TYPE_CHECKING:
    from lfpipe.render.replay_writer import ReplayWriter

NO_ROOM = "make room there, or another --out"  # of a replay
STALE_NS = 500 * MS_NS  # no camera is that slow: a record so old comes from a tracker that has died
COST_SHARE = 0.1  # weight of the newest in the running mean of a picture's cost


class Presenter:
    """One display's pictures. cost_ns: running mean of composing and showing one. picture: the last one, for a screenshot."""

    def __init__(self, context: Context, viewer: Viewer, display: Display) -> None:
        self._context, self._viewer, self._display = context, viewer, display
        self._eyes = context.input("eyes")
        self._buffer = np.empty((), EYES)
        self._record: NDArray[np.void] | None = None
        self._stamp: Stamp | None = None
        self._t_taken_ns = 0
        self._pending = False  # no picture was made yet for the newest record
        self._key: Hashable = None
        trace, began = context.options.trace, context.spec.session.run_dir / "session.json"
        self._trace = TraceFile(Path(trace) if trace else None, self._lost, began if context.row["restarts"] else None)
        self._outputs = OptionalOutputs(context, viewer)
        self._reports = ViewerReports(context, viewer)
        self._replay: ReplayWriter | None = None
        if replay := context.options.replay:
            from lfpipe.render.replay_writer import ReplayWriter

            self._replay = ReplayWriter(Path(replay.folder), replay.sequence, replay.pictures)
        self.cost_ns = 0
        self._shown = ShownPictures()
        self._latency = MotionLatency()
        self._number = 0
        self.clock: ScreenClock | None = None  # of a screen that reports its blanks
        self.lead = LeadTime()
        self.picture: NDArray[np.uint8] | None = None
        self.pattern: GlassesTest | None = None  # shown instead of the scene

    def _lost(self, why: str) -> None:
        if self._context.options.replay:  # a replay needs its trace
            raise UserError(why, NO_ROOM)
        self._context.report_lost(why)

    def redraw(self) -> None:
        """Composes the next picture even if its key is unchanged."""
        self._key = None

    def follow(self, options: SessionOptions) -> None:
        """Opens and closes the optional outputs as the options ask."""
        self._outputs.follow(options, self.picture)

    def take(self) -> Stamp | None:
        """Reads the newest eyes record if there is one; returns its stamp."""
        stamp = self._eyes.take(self._buffer)
        if stamp is not None:
            self.leave_out()
            self._pending = True
            self._record, self._stamp, self._t_taken_ns = self._buffer, stamp, now_ns()
            self._latency.measured(stamp.t_sensor_ns, self._buffer["raw_px"].tolist() if self._buffer["face"] else None)
        return stamp

    def leave_out(self) -> None:
        """Counts the previous record as skipped if no picture was made for it: a newer one came, or the session is paused."""
        self._context.row["left_out"] += self._pending
        self._pending = False

    def show(self, target_ns: int, refresh_ns: int = 0) -> None:
        """Shows the picture for target_ns. refresh_ns: target_ns is a refresh of the display, with the next so much later.

        A picture that stays for a refresh is made for the middle of it, where the error over its time is least.
        """
        t_start_ns = now_ns()
        self._pending = False
        options = self._context.options  # a file has no light, and without a clock replay.latency_ms is the whole delay
        on_screen = not options.lossless and not options.display.startswith("file:")
        loop_ns = int(self._viewer.config.render.loop_ms * 1e6) * on_screen
        seen_ns = target_ns + loop_ns + refresh_ns // 2
        t_sensor_ns = self._stamp.t_sensor_ns if self._stamp else t_start_ns
        if self._record is not None and not options.lossless and t_start_ns - t_sensor_ns > STALE_NS:
            self._record["face"], t_sensor_ns = 0, t_start_ns  # the tracker died or hangs: nobody is seen
        self._viewer.video_lead_ns = round(VIDEO_LEAD * refresh_ns) if self.clock is not None else 0
        viewpoints = self._viewer.viewpoints(self._record, t_sensor_ns, seen_ns)
        key = self._viewer.key(viewpoints)
        composed = key != self._key or not refresh_ns  # the paper draws for every camera frame
        pair: Pair | None = None
        if composed:
            self.picture, pair = self._viewer.compose(viewpoints), self._viewer.compositor.pair
            self._key = key
            if self.pattern is not None:
                self.pattern.draw(self._viewer.config.render, (self._viewer.field.width_px, self._viewer.field.height_px))
                self.picture, pair = self.pattern.picture, self.pattern.pair
        t_composed_ns = now_ns()
        if refresh_ns:
            sleep_until(target_ns if self.clock is None else self.lead.earliest_ns(target_ns, self.clock.period_ns))
        t_shown_ns, cpu_ns = now_ns(), time.process_time_ns()
        t_handed_ns = t_shown_ns
        if composed and self.picture is not None:
            t_handed_ns = self._display.show(self.picture, pair, self._viewer.config.render.anaglyph)
        row, stamp = self._context.row, self._stamp
        measured: tuple[int, int] | None = None
        if composed:
            handing_ns = t_handed_ns - t_shown_ns
            if self.clock is not None:  # a swap may wait for the screen, which is not work
                handing_ns = min(handing_ns, time.process_time_ns() - cpu_ns)
            cost_ns = t_composed_ns - t_start_ns + handing_ns
            self._outputs.picture(self.picture, stamp)
            self.cost_ns += int(COST_SHARE * (cost_ns - self.cost_ns))
            if self.clock is not None:
                self.lead.took(cost_ns + max(t_start_ns - (target_ns - self.lead.ns), 0), self.clock.period_ns)
            if stamp is not None:
                measured = self._t_taken_ns - stamp.t_publish_ns, cost_ns
        row.tick(stamp.source_seq if stamp else -1)
        row["cpu_ns"] = time.process_time_ns()
        line: dict[str, Any] | None = None
        shown: Callable[[int], None] | None = None
        if stamp is not None and self._record is not None:
            row["face"] = int(self._record["face"])
            if row["face"]:
                row["t_face_ns"] = t_start_ns
            self._reports.follow_state()
            if row["face"]:
                row.horizon.add_ns(min(seen_ns - t_sensor_ns, int(MAX_HORIZON_S * 1e9)))
            self._outputs.emit_viewpoints(viewpoints, bool(row["face"]))
            shown = partial(self._was_shown, viewpoints, stamp, bool(row["face"]), composed, seen_ns - target_ns, loop_ns)
            if self._trace.wanted or self._outputs.traced:
                line = self._line(stamp, self._record, viewpoints, composed, t_start_ns, t_composed_ns)
                if self._replay is not None:
                    filtered_px, used_px = self._record["filtered_px"], viewpoints.eyes_px
                    line |= self._replay.keep(stamp, filtered_px, used_px, seen_ns, self.picture, composed)
        self._await_light(target_ns if refresh_ns else 0, composed, t_handed_ns, t_sensor_ns, measured, line, shown)
        self._reports.follow_parallax()

    def _was_shown(
        self, viewpoints: Viewpoints, stamp: Stamp, face: bool, composed: bool, after_ns: int, loop_ns: int, t_ns: int
    ) -> None:
        """Records a picture presented at t_ns, made for the eyes at after_ns later."""
        self._outputs.shown(viewpoints, stamp, face, composed, t_ns)
        if face and composed:
            self._latency.pictured(t_ns, after_ns, loop_ns, viewpoints.eyes_px.tolist())
        if loop_ns and self._context.options.display != "none":  # else there is no light, or its delay is unknown
            self._context.row["onset_ns"], self._context.row["steady_ns"] = self._latency.onset_ns, self._latency.steady_ns

    def _await_light(
        self,
        target_ns: int,
        composed: bool,
        t_handed_ns: int,
        t_sensor_ns: int,
        measured: tuple[int, int] | None,
        line: dict[str, Any] | None,
        shown: Callable[[int], None] | None,
    ) -> None:
        """Counts and traces a picture once its time of display is known. target_ns: the blank it was made for, 0 for none."""

        def report(t_presented_ns: int, by: str) -> None:
            seen = by != REPLACED
            if measured is not None:
                self._context.row.measure(*measured, t_presented_ns - t_sensor_ns if seen else None)
            if by not in ("", HANDOVER) and composed and target_ns and self.clock is not None:
                self._judge(target_ns, t_handed_ns, t_presented_ns)
            if shown is not None and seen:
                shown(t_presented_ns)
            if line is not None:
                line["t_presented_ns"] = t_presented_ns
                if by:
                    line["presented_by"] = by
                self._trace.write(line)
                self._outputs.line(line)

        if line is not None:
            self._eyes.done()
        if not self._display.blanks_by:
            report(t_handed_ns, "")
            return
        self._context.row["planned"] += bool(target_ns)
        if composed:
            self._number += 1
            self._shown.add(self._number, t_handed_ns, report)
        else:
            self._shown.stays(target_ns or t_handed_ns, self._display.blanks_by, report)

    def _judge(self, target_ns: int, t_handed_ns: int, t_presented_ns: int) -> None:
        """Judges a picture shown at its planned blank, at another one, or never (0) because the next one replaced it."""
        assert self.clock is not None
        if not t_presented_ns:
            self._context.row["juddered"] += 1
        elif self.clock.measured:
            self._context.row["juddered"] += self.lead.judge(target_ns, t_handed_ns, t_presented_ns, self.clock.period_ns)

    def missed(self, count: int) -> None:
        """Counts refreshes that passed with no new picture begun: the previous one stayed."""
        row = self._context.row
        row["missed"] += count
        if self.clock is not None:
            row["planned"] += count
            row["juddered"] += count

    def follow_screen(self) -> None:
        """Processes the window system's reports of pictures and blanks."""
        if not self._display.blanks_by:
            return
        answers = self._display.presented()
        if self.clock is not None and answers:
            self.clock.claim(self._display.nominal_hz())
            for answer in answers:
                if answer.t_ns:
                    self.clock.blank(answer.t_ns, answer.period_ns)
        self._shown.take(answers, self._display.blanks_by, now_ns())

    def _line(
        self,
        stamp: Stamp,
        record: NDArray[np.void],
        viewpoints: Viewpoints,
        composed: bool,
        t_started_ns: int,
        t_composed_ns: int,
    ) -> dict[str, Any]:
        def sides(pair: Any) -> dict[str, Any]:
            return {"left": list(pair[0]), "right": list(pair[1])}

        return {
            "seq": self._context.row["seq"] - 1,
            "source_seq": stamp.source_seq,
            "epoch": stamp.epoch,
            "t_sensor_ns": stamp.t_sensor_ns,
            "t_read_ns": stamp.t_read_ns,
            "stamp": StampKind(stamp.kind).word,
            "t_tracked_ns": int(record["t_tracked_ns"]),
            "t_started_ns": t_started_ns,
            "t_composed_ns": t_composed_ns,
            "t_presented_ns": 0,  # known later; the order stays
            "face": bool(record["face"]),
            "eyes_raw": sides(record["raw_px"].tolist()),
            "eyes_used": sides(viewpoints.eyes_px.tolist()),
            "view": sides((viewpoints.left, viewpoints.right)),
            "method": self._viewer.method,
            "level": level_number(self._context.options),
            "composed": composed,
        }

    def close(self) -> None:
        """Ends the trace."""
        self._shown.flush()
        self._trace.close()
        try:
            if self._replay is not None:
                self._replay.close()
        except OSError as error:
            assert self._context.options.replay is not None
            raise UserError(f"{self._context.options.replay.folder}: {error.strerror}", NO_ROOM) from None
        finally:
            self._outputs.close()
