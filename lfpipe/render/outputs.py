"""What render writes and reports besides the picture: the ring "pictures", the timeline, the viewpoints, presence and visits.

All follow the session's options; without a request there is no ring, no copy, no message.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.files.output import VISITS_HEADER, output_file
from lfpipe.files.safe_files import read_text, reason
from lfpipe.files.trace import TraceFile
from lfpipe.host.files import is_missing
from lfpipe.render.geometry import Parallax
from lfpipe.render.presence import ViewerState
from lfpipe.render.viewer import Viewer, Viewpoints
from lfpipe.transport import ring
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Stamp
from lfpipe.transport.ring_ends import RingOutput

VIEWPOINTS_NS = 100 * MS_NS  # between two messages "look"


class OptionalOutputs:
    """Call `follow` whenever options may have changed; without a request the other calls cost next to nothing."""

    def __init__(self, context: Context, viewer: Viewer) -> None:
        self._context, self._viewer = context, viewer
        self._part, self._ring = "", None  # type: tuple[str, ring.Writer | None]
        self._path, self._starting = "", True
        self._timeline = TraceFile(None, self._lost)
        self._viewpoints_due_ns = 0
        self._shown: RingOutput | None = None  # opened when it is first needed

    def follow(self, options: SessionOptions, picture: NDArray[np.uint8] | None) -> None:
        """Opens and closes outputs as options ask. picture: the one on the screen, for a new ring."""
        part, path = options.pictures, options.timeline
        if part != self._part:
            if self._ring is not None:
                self._ring.close()
            self._part, self._ring = part, None
            if part:
                try:
                    self._ring = ring.Writer(self._context.spec.session.segment(part))
                except FileNotFoundError:
                    return  # released before it was used
                self.picture(picture, None)
        if path != self._path:
            self._path = path
            self._timeline.close()
            # a timeline that runs when this process starts was begun by the one before it
            began = self._context.spec.session.run_dir / "session.json" if self._starting else None
            self._timeline = TraceFile(Path(path) if path else None, self._lost, began)
        self._starting = False

    def _lost(self, why: str) -> None:
        self._context.report_lost(why)

    @property
    def traced(self) -> bool:
        """Whether the timeline is requested."""
        return self._timeline.wanted

    def line(self, record: dict[str, Any]) -> None:
        """Writes one object of the trace to the timeline."""
        self._timeline.write(record)

    def picture(self, picture: NDArray[np.uint8] | None, stamp: Stamp | None) -> None:
        """Writes a picture just shown to the ring. A picture of another size, right after a change of scene, is left out."""
        if self._ring is None or picture is None or picture.shape != self._ring.shape:
            return
        np.copyto(self._ring.begin(), picture)
        if stamp is None:
            self._ring.publish(-1, 0, 0)
        else:
            self._ring.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind)

    def shown(self, viewpoints: Viewpoints, stamp: Stamp, face: bool, composed: bool, t_presented_ns: int) -> None:
        """Writes stamp and views of a picture for the share stage."""
        if not self._context.options.shares_pictures:
            return
        self._shown = self._shown or self._context.output("shown")
        record = self._shown.begin()
        record["t_presented_ns"], record["view"] = t_presented_ns, (viewpoints.left, viewpoints.right)
        record["composed"], record["face"] = composed, face
        self._shown.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind)

    def emit_viewpoints(self, viewpoints: Viewpoints, face: bool) -> None:
        """Reports positions and views of the eyes to the tap, at most every VIEWPOINTS_NS."""
        if self._ring is None or now_ns() < self._viewpoints_due_ns:
            return
        self._viewpoints_due_ns = now_ns() + VIEWPOINTS_NS
        field, solver = self._viewer.field, self._viewer.solver
        self._context.emit(
            "look",
            face=face,
            eyes_px=[list(viewpoints.eyes_px[:2]), list(viewpoints.eyes_px[2:])],
            views=[list(viewpoints.left), list(viewpoints.right)],
            grid=[field.rows, field.cols],
            alpha_px=solver.alpha_px if solver else 0.0,
            centre_px=list(solver.centre_px) if solver else [0.0, 0.0],
            method=self._viewer.method,
        )

    def close(self) -> None:
        """Ends the timeline; the ring ends with the process."""
        self._timeline.close()


class ViewerReports:
    """Emits each change once. Raises UserError if option visits names a file of another program."""

    def __init__(self, context: Context, viewer: Viewer) -> None:
        self._context, self._viewer = context, viewer
        self._parallax: Parallax | None = None
        self._visits = VisitLog(Path(context.options.visits)) if context.options.visits else None

    def follow_state(self) -> None:
        """Emits viewer (nobody, arriving, seated, lost, exchanged)."""
        state = self._viewer.presence.state
        before = ViewerState(int(self._context.row["viewer"]))
        if state == before:
            return
        self._context.row["viewer"] = int(state)
        self._context.emit("viewer", state=state.word)
        if self._visits is not None:
            try:
                self._visits.follow(before, state)
            except OSError as error:
                self._context.emit("notice", text=f"{self._context.options.visits}: cannot write visits: {reason(error)}")

    def follow_parallax(self) -> None:
        """Emits parallax when scene, settings or screen change it, but not at every step of a viewer, nor in a replay, which
        nobody watches."""
        if self._context.options.lossless:
            return
        chosen = self._viewer.parallax
        if chosen is not None and (self._parallax is None or chosen.differs_from(self._parallax)):
            self._parallax = chosen
            self._context.emit("parallax", text=str(chosen))


MAX_BYTES = 4 << 20  # two decades
BEGINNING = (ViewerState.ARRIVING, ViewerState.EXCHANGED)


class VisitLog:
    """Counts visitors in a CSV file of lines `2026-11-21 15:00,12`. Raises UserError if path is a different kind of file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._counts: dict[str, int] = {}
        if not is_missing(path):
            text = read_text(path, MAX_BYTES, str(path), "name a file that no other program wrote")
            for hour, _, count in (line.partition(",") for line in text.splitlines()[1:]):
                self._counts[hour] = int(count) if count.isdecimal() else 0

    def follow(self, before: ViewerState, now: ViewerState) -> None:
        """Handles a change of state: somebody who rests before the screen is a visitor. Raises OSError; the count is kept for the
        next call."""
        if now is ViewerState.SEATED and before in BEGINNING:
            hour = time.strftime("%Y-%m-%d %H:00")
            self._counts[hour] = self._counts.get(hour, 0) + 1
            rows = "".join(f"{each},{count}\n" for each, count in sorted(self._counts.items()))
            with output_file(self._path) as file:
                file.write(VISITS_HEADER + rows.encode())
