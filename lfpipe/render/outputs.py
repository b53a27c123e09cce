"""What render writes and reports besides the picture: the ring "pictures", the timeline, viewpoints, presence and parallax.

Without a request there is no ring and no copy.
"""

import contextlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.files.trace import TraceFile
from lfpipe.render.geometry import Parallax
from lfpipe.render.viewer import Viewer, Viewpoints
from lfpipe.transport import ring
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Stamp
from lfpipe.transport.ring_ends import RingOutput

VIEWPOINTS_NS = 100 * MS_NS  # between two messages "look"


class Outputs:
    """Call `follow` whenever options may have changed. ring: for requested pictures; None: neither these nor viewpoints; it ends
    with the process. timeline: to be closed."""

    def __init__(self, context: Context, viewer: Viewer) -> None:
        self._context, self._viewer = context, viewer
        self._options = SessionOptions()  # those followed last
        self.ring: ring.Writer | None = None
        # a timeline that runs when this process starts was begun by the one before it
        self._began: Path | None = context.spec.session.run_dir / "session.json"
        self.timeline = TraceFile(None, context.report_lost)
        self._parallax: Parallax | None = None  # reported last
        self._viewpoints_due_ns = 0
        self._shown: RingOutput | None = None  # opened when it is first needed

    def follow(self, options: SessionOptions, picture: NDArray[np.uint8] | None) -> None:
        """Opens and closes outputs as options ask. picture: the one on the screen, for a new ring."""
        before, self._options = self._options, options
        if options.timeline != before.timeline:
            self.timeline.close()
            path = Path(options.timeline) if options.timeline else None
            self.timeline = TraceFile(path, self._context.report_lost, self._began)
        self._began = None
        if options.pictures != before.pictures:
            if self.ring is not None:
                self.ring.close()
            self.ring = None
            with contextlib.suppress(FileNotFoundError):  # released before it was used
                self.ring = ring.Writer(self._context.spec.session.segment(options.pictures)) if options.pictures else None
            self.picture(picture, None)

    def picture(self, picture: NDArray[np.uint8] | None, stamp: Stamp | None) -> None:
        """Writes a picture just shown to the ring. A picture of another size, right after a change of scene, is left out."""
        if self.ring is None or picture is None or picture.shape != self.ring.shape:
            return
        np.copyto(self.ring.begin(), picture)
        if stamp is None:
            self.ring.publish(-1, 0, 0)
        else:
            self.ring.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind)

    def share(self, viewpoints: Viewpoints, stamp: Stamp, face: bool, composed: bool, t_presented_ns: int) -> None:
        """Writes stamp and views of a picture for the share stage."""
        self._shown = self._shown or self._context.output("shown")
        record = self._shown.begin()
        record["t_presented_ns"], record["view"] = t_presented_ns, (viewpoints.left, viewpoints.right)
        record["composed"], record["face"] = composed, face
        self._shown.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind)

    def emit_viewpoints(self, viewpoints: Viewpoints, face: bool) -> None:
        """Reports the eyes and the grid of views over them to the tap, at most every VIEWPOINTS_NS."""
        if now_ns() < self._viewpoints_due_ns:
            return
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

    def report_viewer(self) -> None:
        """Emits a changed state of the viewer: nobody, arriving, seated, lost, exchanged."""
        state = self._viewer.presence.state
        self._context.row["viewer"] = int(state)
        self._context.emit("viewer", state=state.word)

    def report_parallax(self) -> None:
        """Emits parallax when scene, settings or screen change it, but not at every step of a viewer, nor in a replay, which
        nobody watches."""
        chosen = None if self._context.options.lossless else self._viewer.parallax
        if chosen is not None and (self._parallax is None or chosen.differs_from(self._parallax)):
            self._parallax = chosen
            self._context.emit("parallax", text=str(chosen))
