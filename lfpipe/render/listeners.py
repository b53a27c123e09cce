"""What takes each showing: the status row, the trace, the ring of pictures, the stamps for sharing,
and the messages to the tap.
"""

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.config.modes import Lossless, MouseViewer
from lfpipe.config.quality import level_number
from lfpipe.eyes import MAX_HORIZON_S
from lfpipe.files.trace import TraceFile
from lfpipe.render.display import Display
from lfpipe.render.geometry import Parallax
from lfpipe.render.presence import ViewerState
from lfpipe.render.showing import REPLACED, Listener, Showing
from lfpipe.render.viewer import Viewer
from lfpipe.transport import ring
from lfpipe.transport.clock import MS_NS
from lfpipe.transport.ring import Stamp, StampKind
from lfpipe.transport.ring_ends import RingOutput
from lfpipe.transport.status import Row

HORIZON_NS = int(MAX_HORIZON_S * 1e9)
LOOK_NS = 100 * MS_NS  # between two messages "look"


class StatusRow(Listener):
    """Counts showings in the stage's row of the status table, and measures them."""

    def __init__(self, row: Row, viewer: Viewer, display: Display) -> None:
        self._row = row
        self._viewer = viewer
        self._display = display

    def handed_over(self, showing: Showing) -> None:
        row = self._row
        eyes = showing.eyes
        row.tick(eyes.stamp.source_seq if eyes else -1)
        row["cpu_ns"] = time.process_time_ns()
        row["planned"] += bool(showing.due_ns and self._display.blanks_by)
        if eyes is None:
            return
        row["viewer"] = int(self._viewer.presence.state)
        row["face"] = showing.face
        if showing.face:
            row["t_face_ns"] = showing.t_started_ns
            row.horizon.add_ns(min(showing.moment.seen_ns - eyes.t_ns, HORIZON_NS))

    def missed(self, count: int) -> None:
        """Counts refreshes that passed with no new picture begun: the previous one stayed."""
        self._row["missed"] += count
        if self._display.blanks_by:
            self._row["planned"] += count
            self._row["juddered"] += count

    def presented(self, showing: Showing) -> None:
        self._row["juddered"] += showing.juddered
        eyes = showing.eyes
        if eyes is not None and showing.composed:
            age_ns = showing.t_presented_ns - eyes.t_ns if showing.by != REPLACED else None
            self._row.measure(eyes.waited_ns, showing.cost_ns, age_ns)


def trace_line(showing: Showing, method: str, level: int) -> dict[str, Any]:
    """The line of a showing with eyes (docs/contracts.md). method, level: in force."""
    eyes = showing.eyes
    assert eyes is not None
    stamp = eyes.stamp
    raw_px = eyes.record.raw_px
    viewpoints = showing.viewpoints
    line = {
        "seq": showing.seq,
        "source_seq": stamp.source_seq,
        "epoch": stamp.epoch,
        "t_sensor_ns": stamp.t_sensor_ns,
        "t_read_ns": stamp.t_read_ns,
        "stamp": StampKind(stamp.kind).word,
        "t_tracked_ns": eyes.record.t_tracked_ns,
        "t_started_ns": showing.t_started_ns,
        "t_composed_ns": showing.t_composed_ns,
        "t_due_ns": showing.due_ns,
        "t_presented_ns": showing.t_presented_ns,
        "face": showing.face,
        "eyes_raw": {"left": raw_px[:2], "right": raw_px[2:]},
        "eyes_used": {"left": viewpoints.eyes_px[:2], "right": viewpoints.eyes_px[2:]},
        "view": {"left": list(viewpoints.left), "right": list(viewpoints.right)},
        "method": method,
        "level": level,
        "composed": showing.composed,
        **showing.more,
    }
    if showing.by:
        line["presented_by"] = showing.by
    return line


class Trace(Listener):
    """Writes a line per showing: the trace of a session and, while one is wanted, a timeline."""

    def __init__(
        self, viewer: Viewer, path: Path | None, began: Path | None, lost: Callable[[str], None]
    ) -> None:
        """path: of the trace. began: a file that the session wrote at its start, for a restarted
        process, which continues what the one before it wrote. lost: is called once with the reason
        if a file ends early.
        """
        self._viewer = viewer
        self._began = began
        self._lost = lost
        self._trace = TraceFile(path, lost, began)
        self._timeline = TraceFile(None, lost)
        self._timeline_path = ""
        self._level = 0

    def set_options(self, options: SessionOptions) -> None:
        self._level = level_number(options)
        if options.timeline != self._timeline_path:
            self._timeline_path = options.timeline
            self._timeline.close()
            path = Path(options.timeline) if options.timeline else None
            self._timeline = TraceFile(path, self._lost, self._began)
        self._began = None

    def presented(self, showing: Showing) -> None:
        if showing.eyes is not None and (self._trace.wanted or self._timeline.wanted):
            line = trace_line(showing, self._viewer.method, self._level)
            self._trace.write(line)
            self._timeline.write(line)

    def close(self) -> None:
        self._trace.close()
        self._timeline.close()


class PictureRing(Listener):
    """Writes every new picture to the ring of option "pictures", for previews and exports; without
    a request there is no ring and no copy. The ring ends with the process.
    """

    def __init__(self, segment: Callable[[str], str]) -> None:
        """segment: the shared memory of a ring."""
        self._segment = segment
        self._name = ""
        self._ring: ring.Writer | None = None
        self._picture: NDArray[np.uint8] | None = None  # on the screen, for a new ring

    def set_options(self, options: SessionOptions) -> None:
        if options.pictures == self._name:
            return
        self._name = options.pictures
        if self._ring is not None:
            self._ring.close()
        self._ring = None
        if options.pictures:
            with contextlib.suppress(FileNotFoundError):  # released before it was used
                self._ring = ring.Writer(self._segment(options.pictures))
        self._write(None)

    def handed_over(self, showing: Showing) -> None:
        self._picture = showing.picture
        if showing.composed:
            self._write(showing.eyes.stamp if showing.eyes else None)

    def _write(self, stamp: Stamp | None) -> None:
        """Writes the picture. One of another size, right after a change of scene, is left out."""
        picture = self._picture
        if self._ring is None or picture is None or picture.shape != self._ring.shape:
            return
        np.copyto(self._ring.begin(), picture)
        if stamp is None:
            self._ring.publish(-1, 0, 0)
        else:
            self._ring.publish(
                stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
            )


class ShareStamps(Listener):
    """Writes a record of dtype SHOWN for each showing while a target of `--share` wants them."""

    def __init__(self, open_ring: Callable[[], RingOutput]) -> None:
        """open_ring: opens the ring "shown"; called when it is first needed."""
        self._open_ring = open_ring
        self._ring: RingOutput | None = None
        self._wanted = False

    def set_options(self, options: SessionOptions) -> None:
        self._wanted = any(target.startswith("lsl") for target in options.share)

    def presented(self, showing: Showing) -> None:
        if not self._wanted or showing.by == REPLACED or showing.eyes is None:
            return
        self._ring = self._ring or self._open_ring()
        record = self._ring.begin()
        record["t_presented_ns"] = showing.t_presented_ns
        record["view"] = (showing.viewpoints.left, showing.viewpoints.right)
        record["composed"] = showing.composed
        record["face"] = showing.face
        stamp = showing.eyes.stamp
        self._ring.publish(
            stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
        )


class TapMessages(Listener):
    """Sends "viewer" for another state of the viewer, "parallax" for another alpha, a "notice" of
    its summary when somebody is seated for the first time and, while somebody watches the pictures,
    "look" with the eyes and the grid of views over them.
    """

    def __init__(self, emit: Callable[..., None], viewer: Viewer, state: ViewerState) -> None:
        """emit: as `Context.emit`. state: the viewer's, as reported last."""
        self._emit = emit
        self._viewer = viewer
        self._state = state
        self._options = SessionOptions()
        self._look_due_ns = 0
        self._parallax: Parallax | None = None  # reported last
        self._was_seated = False

    def set_options(self, options: SessionOptions) -> None:
        self._options = options

    def handed_over(self, showing: Showing) -> None:
        viewer = self._viewer
        if showing.eyes is not None:
            if viewer.presence.state is not self._state:
                self._state = viewer.presence.state
                self._emit("viewer", state=self._state.word)
            if self._options.pictures and showing.t_handed_ns >= self._look_due_ns:
                self._look_due_ns = showing.t_handed_ns + LOOK_NS
                self._emit_look(showing)
        parallax = viewer.parallax
        if parallax is None or isinstance(self._options.clock, Lossless):  # nobody watches a replay
            return
        if self._parallax is None or parallax.differs_from(self._parallax):
            self._parallax = parallax
            self._emit("parallax", text=str(parallax))
        if self._state is ViewerState.SEATED and not self._was_seated:
            self._was_seated = True
            if not isinstance(self._options.viewer, MouseViewer):  # its distance is assumed
                self._emit("notice", text=parallax.summary)

    def _emit_look(self, showing: Showing) -> None:
        field = self._viewer.field
        solver = self._viewer.solver
        eyes_px = showing.viewpoints.eyes_px
        self._emit(
            "look",
            face=showing.face,
            eyes_px=[list(eyes_px[:2]), list(eyes_px[2:])],
            grid=[field.rows, field.cols],
            alpha_px=solver.alpha_px if solver else 0.0,
            centre_px=list(solver.centre_px) if solver else [0.0, 0.0],
        )
