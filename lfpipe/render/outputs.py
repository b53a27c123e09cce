"""What render writes and reports of the pictures it has shown: trace and timeline, a replay's pictures, the ring "pictures",
stamps for the share stage, and messages to the tap.

Without a request there is no ring, no line and no copy.
"""

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.config.quality import level_number
from lfpipe.errors import UserError
from lfpipe.files.trace import TraceFile
from lfpipe.render.geometry import Parallax
from lfpipe.render.showing import REPLACED, Showing
from lfpipe.render.viewer import Viewer, Viewpoints
from lfpipe.transport import ring
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Stamp
from lfpipe.transport.ring_ends import RingOutput

if TYPE_CHECKING:
    from lfpipe.render.replay_writer import ReplayWriter

VIEWPOINTS_NS = 100 * MS_NS  # between two messages "look"


class Outputs:
    """Call `follow` whenever options may have changed, `handed_over` and `presented` for each showing. traced: whether a trace or
    timeline gets lines."""

    def __init__(self, context: Context, viewer: Viewer) -> None:
        self._context, self._viewer = context, viewer
        self._options = SessionOptions()  # those followed last
        trace, began = context.options.trace, context.spec.session.run_dir / "session.json"
        self._trace = TraceFile(
            Path(trace) if trace else None, self._lost, began if context.row["restarts"] else None
        )
        # a timeline that runs when this process starts was begun by the one before it
        self._began: Path | None = began
        self._timeline = TraceFile(None, context.report_lost)
        self._replay: ReplayWriter | None = None
        if replay := context.options.replay:
            from lfpipe.render import replay_writer

            self._replay = replay_writer.ReplayWriter(
                Path(replay.folder), replay.sequence, replay.pictures
            )
        self._ring: ring.Writer | None = (
            None  # of pictures; None: nobody asks for these or viewpoints; it ends with the process
        )
        self._viewpoints_due_ns = 0
        self._shown: RingOutput | None = None  # opened when it is first needed
        self._parallax: Parallax | None = None  # reported last

    def _lost(self, why: str) -> None:
        if self._context.options.replay is not None:  # it needs its trace
            raise UserError(why, "make room there, or another --out")
        self._context.report_lost(why)

    def follow(self, options: SessionOptions, picture: NDArray[np.uint8] | None) -> None:
        """Opens and closes outputs as options ask. picture: the one on the screen, for a new ring."""
        before, self._options = self._options, options
        if options.timeline != before.timeline:
            self._timeline.close()
            path = Path(options.timeline) if options.timeline else None
            self._timeline = TraceFile(path, self._context.report_lost, self._began)
        self._began = None
        self.traced = self._trace.wanted or self._timeline.wanted
        self._shares = any(
            target.startswith("lsl") for target in options.share
        )  # it carries stamps of pictures
        if options.pictures != before.pictures:
            if self._ring is not None:
                self._ring.close()
            self._ring = None
            with contextlib.suppress(FileNotFoundError):  # released before it was used
                self._ring = (
                    ring.Writer(self._context.spec.session.segment(options.pictures))
                    if options.pictures
                    else None
                )
            self._write_picture(picture, None)

    def handed_over(self, showing: Showing, picture: NDArray[np.uint8] | None) -> None:
        """Takes what was handed to the display. picture: the one on the screen now."""
        stamp, record, viewer = showing.stamp, showing.record, self._viewer
        if stamp is not None and record is not None:
            if self._replay is not None:
                used_px = showing.viewpoints.eyes_px
                showing.more = self._replay.keep(
                    stamp, record.filtered_px, used_px, showing.seen_ns, picture, showing.number > 0
                )
            if viewer.presence.state != self._context.row["viewer"]:
                self._context.row["viewer"] = int(viewer.presence.state)
                self._context.emit("viewer", state=viewer.presence.state.word)
        if self._ring is not None:
            if showing.number:
                self._write_picture(picture, stamp)
            if stamp is not None and now_ns() >= self._viewpoints_due_ns:
                self._emit_viewpoints(showing.viewpoints, bool(showing.face))
        parallax = None if self._options.lossless else viewer.parallax  # nobody watches a replay
        if parallax is not None and (
            self._parallax is None or parallax.differs_from(self._parallax)
        ):
            self._parallax = parallax
            self._context.emit("parallax", text=str(parallax))

    def presented(self, showing: Showing, stamp: Stamp) -> None:
        """Takes a showing whose time of display is known. stamp: of its frame."""
        if self._shares and showing.by != REPLACED:
            self._shown = self._shown or self._context.output("shown")
            record, viewpoints = self._shown.begin(), showing.viewpoints
            record["t_presented_ns"], record["view"] = (
                showing.t_presented_ns,
                (viewpoints.left, viewpoints.right),
            )
            record["composed"], record["face"] = showing.number > 0, showing.face
            self._shown.publish(
                stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
            )
        if self.traced:
            line = showing.line(stamp, self._viewer.method, level_number(self._context.options))
            self._trace.write(line)
            self._timeline.write(line)

    def _write_picture(self, picture: NDArray[np.uint8] | None, stamp: Stamp | None) -> None:
        """Writes a picture to the ring. A picture of another size, right after a change of scene, is left out."""
        if self._ring is None or picture is None or picture.shape != self._ring.shape:
            return
        np.copyto(self._ring.begin(), picture)
        if stamp is None:
            self._ring.publish(-1, 0, 0)
        else:
            self._ring.publish(
                stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
            )

    def _emit_viewpoints(self, viewpoints: Viewpoints, face: bool) -> None:
        """Reports the eyes and the grid of views over them."""
        self._viewpoints_due_ns = now_ns() + VIEWPOINTS_NS
        field, solver = self._viewer.field, self._viewer.solver
        self._context.emit(
            "look",
            face=face,
            eyes_px=[list(viewpoints.eyes_px[:2]), list(viewpoints.eyes_px[2:])],
            grid=[field.rows, field.cols],
            alpha_px=solver.alpha_px if solver else 0.0,
            centre_px=list(solver.centre_px) if solver else [0.0, 0.0],
        )

    def close(self) -> None:
        """Ends the files. Raises UserError if there is no room for a replay's pictures."""
        self._trace.close()
        self._timeline.close()
        if self._replay is not None:
            try:
                self._replay.close()
            except OSError as error:
                self._lost(f"{self._replay.folder}: {error.strerror}")
