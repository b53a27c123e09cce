"""The listeners of presentations: each records one aspect of every picture that was presented.

Status row, trace, messages of the tap, ring of pictures, ring of stamps, the viewpoints of a live
scene, and what a replay keeps.
"""

import contextlib
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.config.quality import level_number
from lfpipe.config.session_options import Lossless, MouseViewer
from lfpipe.eyes import MAX_PREDICTION_S
from lfpipe.files.codecs import fit_area
from lfpipe.files.safe_files import TraceFile, write_file
from lfpipe.render.display.display import Display
from lfpipe.render.live_input import LiveInput
from lfpipe.render.presenter import REPLACED, Listener, Presentation
from lfpipe.render.synthesis.anaglyph import scale_into
from lfpipe.render.viewer.geometry import Parallax
from lfpipe.render.viewer.presence import ViewerState
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.sequence.packets import PacketWriter, encoded, read_truth
from lfpipe.transport.context import BEAT_NS, Context, RingOutput
from lfpipe.transport.ring import SECOND_NS, Stamp, StampKind, Writer
from lfpipe.transport.status import Row

MAX_PREDICTION_NS = int(MAX_PREDICTION_S * SECOND_NS)


@attrs.define(eq=False)
class StatusRow(Listener):
    """Counts and measures presentations in the stage's row of the status table."""

    _row: Row
    _viewer: Viewer
    _display: Display

    def handed_over(self, presentation: Presentation) -> None:
        row, eyes = self._row, presentation.eyes
        row.count_output(eyes.stamp.source_seq if eyes else -1)
        row["cpu_ns"] = time.process_time_ns()
        row["planned"] += bool(presentation.due_ns and self._display.vblank_source)
        if eyes is None:
            return
        row["viewer"] = int(self._viewer.presence.state)
        row["face"] = presentation.face
        if presentation.face:
            row["t_face_ns"] = presentation.t_started_ns
            row.histograms["prediction"].add_ns(
                min(presentation.display_time.seen_ns - eyes.t_ns, MAX_PREDICTION_NS)
            )

    def missed(self, count: int) -> None:
        """Counts refreshes without a new picture that was due."""
        self._row["missed"] += count
        if self._display.vblank_source:
            self._row["planned"] += count
            self._row["juddered"] += count

    def presented(self, presentation: Presentation) -> None:
        self._row["juddered"] += presentation.juddered
        eyes, t_ns = presentation.eyes, presentation.t_presented_ns
        if eyes is not None and presentation.composed:
            age_ns = t_ns - eyes.t_ns if presentation.by != REPLACED else None
            self._row.record_latency(eyes.waited_ns, presentation.cost_ns, age_ns)


# Trace lines of presentations.


def trace_line(presentation: Presentation, method: str, level: int) -> dict[str, Any]:
    """The trace line of a presentation with eyes (docs/contracts.md). method, level: current."""
    eyes = presentation.eyes
    assert eyes is not None
    stamp, raw_px = eyes.stamp, eyes.record.raw_px
    viewpoints = presentation.viewpoints
    line = {
        "seq": presentation.seq,
        "source_seq": stamp.source_seq,
        "epoch": stamp.epoch,
        "t_sensor_ns": stamp.t_sensor_ns,
        "t_read_ns": stamp.t_read_ns,
        "stamp": StampKind(stamp.kind).word,
        "t_tracked_ns": eyes.record.t_tracked_ns,
        "t_started_ns": presentation.t_started_ns,
        "t_composed_ns": presentation.t_composed_ns,
        "t_due_ns": presentation.due_ns,
        "t_presented_ns": presentation.t_presented_ns,
        "face": presentation.face,
        "eyes_raw": {"left": raw_px[:2], "right": raw_px[2:]},
        "eyes_used": {"left": viewpoints.eyes_px[:2], "right": viewpoints.eyes_px[2:]},
        "view": {"left": list(viewpoints.left), "right": list(viewpoints.right)},
        "method": method,
        "level": level,
        "composed": presentation.composed,
        **presentation.more,
    }
    if presentation.by:
        line["presented_by"] = presentation.by
    return line


@attrs.define(eq=False)
class Trace(Listener):
    """Writes a line per presentation to the file of option "trace"."""

    _viewer: Viewer
    _began: Path | None
    """A file that the session wrote at its start; a restarted process continues a newer trace than
    that."""
    _lost: Callable[[str], None]
    """Called once with the reason if a file ends early."""
    _path: str = ""
    _file: TraceFile | None = None
    _level: int = 0

    def set_options(self, options: SessionOptions) -> None:
        self._level = level_number(options)
        if options.trace != self._path:
            self.close()
            self._path = options.trace
            self._file = (
                TraceFile(Path(options.trace), self._lost, self._began) if options.trace else None
            )
        self._began = None

    def presented(self, presentation: Presentation) -> None:
        if presentation.eyes is not None and self._file is not None:
            self._file.write(trace_line(presentation, self._viewer.compositor.method, self._level))

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


# Messages about the viewer to monitors.


@attrs.define(eq=False)
class TapMessages(Listener):
    """Sends "viewer" when the viewer's state changes, "parallax" when alpha changes, a "notice" of
    its summary when somebody is seated for the first time and, while pictures are leased,
    "look" with the eyes and the grid of views over them.
    """

    _emit: Callable[..., None]
    """As `Context.emit`."""
    _viewer: Viewer
    _state: ViewerState
    """The viewer's, as reported last."""
    _options: SessionOptions = attrs.field(factory=SessionOptions)
    _look_due_ns: int = 0
    _parallax: Parallax | None = None  # reported last
    _was_seated: bool = False

    def set_options(self, options: SessionOptions) -> None:
        self._options = options

    def handed_over(self, presentation: Presentation) -> None:
        viewer = self._viewer
        if presentation.eyes is not None:
            if viewer.presence.state is not self._state:
                self._state = viewer.presence.state
                self._emit("viewer", state=self._state.word)
            if self._options.pictures and presentation.t_handed_ns >= self._look_due_ns:
                self._look_due_ns = presentation.t_handed_ns + BEAT_NS
                eyes_px, field = presentation.viewpoints.eyes_px, viewer.field
                self._emit(
                    "look",
                    face=presentation.face,
                    eyes_px=[list(eyes_px[:2]), list(eyes_px[2:])],
                    grid=[field.rows, field.cols],
                    alpha_px=viewer.solver.alpha_px if viewer.solver else 0.0,
                    centre_px=list(viewer.solver.centre_px) if viewer.solver else [0.0, 0.0],
                )
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


# The ring of pictures, for previews and exports.


@attrs.define(eq=False)
class PictureRing(Listener):
    """Writes every new picture to the ring of option "pictures". Without a request there is no ring
    and no copy.
    """

    _segment: Callable[[str], Path]
    """The shared memory of a ring."""
    _name: str = ""
    _ring: Writer | None = None
    _picture: NDArray[np.uint8] | None = None  # on the screen, for a new ring

    def set_options(self, options: SessionOptions) -> None:
        if options.pictures == self._name:
            return
        self._name = options.pictures
        if self._ring is not None:
            self._ring.close()
        self._ring = None
        if options.pictures:
            with contextlib.suppress(FileNotFoundError):  # released before it was used
                self._ring = Writer(self._segment(options.pictures))
        self._write(None)

    def handed_over(self, presentation: Presentation) -> None:
        self._picture = presentation.picture
        if presentation.composed:
            self._write(presentation.eyes.stamp if presentation.eyes else None)

    def _write(self, stamp: Stamp | None) -> None:
        """Writes the picture, scaled up where the screen shows less than the scene's own size;
        skips one of another aspect right after a change of scene.
        """
        picture = self._picture
        if self._ring is None or picture is None:
            return
        size_px = picture.shape[1], picture.shape[0]
        if fit_area((self._ring.shape[1], self._ring.shape[0]), size_px)[2:] != size_px:
            return
        scale_into(picture, self._ring.begin())
        stamp = stamp or Stamp(0, -1, 0, 0, 0, 0, 0)  # of no frame
        self._ring.publish(
            stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
        )


# Stamps of presented pictures, for stages that request them.


@attrs.define(eq=False)
class ShownStamps(Listener):
    """Writes a record of dtype SHOWN for each presentation while a stage requests the ring."""

    _open_ring: Callable[[], RingOutput]
    """Opens the ring "shown"; called when it is first needed."""
    _ring: RingOutput | None = None
    _wanted: bool = False

    def set_options(self, options: SessionOptions) -> None:
        self._wanted = "shown" in options.asked_for

    def presented(self, presentation: Presentation) -> None:
        if not self._wanted or presentation.by == REPLACED or presentation.eyes is None:
            return
        self._ring = self._ring or self._open_ring()
        record = self._ring.begin()
        record["t_presented_ns"] = presentation.t_presented_ns
        record["view"] = (presentation.viewpoints.left, presentation.viewpoints.right)
        record["composed"] = presentation.composed
        record["face"] = presentation.face
        stamp = presentation.eyes.stamp
        self._ring.publish(
            stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch, stamp.kind
        )


# What a live scene adds to presentations: its age, whether disparity is of its own frame, and the
# viewpoints for the stage that measures disparity and for the program that draws the scene.


class LiveRow(Listener):
    """Reports the live scene of presentations."""

    def __init__(self, context: Context, source: LiveInput, viewer: Viewer) -> None:
        self._row, self._source, self._viewer = context.row, source, viewer
        self._viewpoints = context.output("viewpoints")

    def handed_over(self, presentation: Presentation) -> None:
        stamp, own = self._source.stamp, self._source.own_disparity
        if stamp is None:
            return
        presentation.more |= {"t_views_ns": stamp.t_sensor_ns, "own_disparity": own}
        self._row["live"] += presentation.composed
        self._row["own_disparity"] += presentation.composed and own
        record = self._viewpoints.begin()
        record["left"], record["right"] = presentation.viewpoints[1:3]
        record["left_mm"], record["right_mm"] = self._viewer.eyes_mm()
        self._viewpoints.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns)

    def presented(self, presentation: Presentation) -> None:
        t_views_ns = presentation.more.get("t_views_ns")
        if t_views_ns is not None and presentation.composed and presentation.by != REPLACED:
            self._row.histograms["views_age"].add_ns(
                max(presentation.t_presented_ns - t_views_ns, 0)
            )


# The pictures that a replay keeps: a digest of each, a few for people, and as many as fit for a
# comparison: packets in folder/pictures, of every composed one while they take less than
# STORED_BYTES, then of every second, fourth, ... frame, so that two runs have frames in common.


STORED_BYTES = 8 << 20  # a reference is committed
PICTURES = "pictures"


class ReplayWriter(Listener):
    """folder: of the run's results. sequence: its folder, whose true eyes determine the worst
    picture. pictures: keep them.
    """

    def __init__(
        self,
        folder: Path,
        sequence: str,
        pictures: bool,
        lost: Callable[[str], None],
    ) -> None:
        """lost: called with the reason if the disk is full."""
        self._folder, self._pictures, self._lost = folder, pictures, lost
        self._truth = read_truth(Path(sequence))
        self._first_ns: int | None = None
        self._digest = ""
        self._stride = 1
        self._stored = dict[int, tuple[Stamp, bytes]]()
        self._named: dict[str, NDArray[np.uint8]] = {}  # first, last and worst picture
        self._worst_px = -1.0

    def handed_over(self, presentation: Presentation) -> None:
        """Stores the picture; adds eyes_filtered and its digest to the trace line."""
        if presentation.eyes is None:
            return
        stamp, picture = presentation.eyes.stamp, presentation.picture
        self._first_ns = stamp.t_sensor_ns if self._first_ns is None else self._first_ns
        if picture is not None:
            if presentation.composed:
                self._digest = f"{zlib.crc32(picture.data):08x}"
                if self._pictures:
                    self._store(stamp, picture)
                if not self._named:
                    self._named["first"] = picture.copy()
                self._named["last"] = picture
            if self._truth:
                used_px = np.reshape(presentation.viewpoints.eyes_px, (2, 2))
                seen_ns = presentation.display_time.seen_ns - self._first_ns
                error_px = float(self._truth.error_px(used_px, seen_ns))
                if error_px > self._worst_px:
                    self._named["worst"] = picture.copy()
                    self._worst_px = error_px
        filtered_px = presentation.eyes.record.filtered_px
        presentation.more["eyes_filtered"] = {"left": filtered_px[:2], "right": filtered_px[2:]}
        presentation.more["picture"] = self._digest

    def _store(self, stamp: Stamp, picture: NDArray[np.uint8]) -> None:
        if stamp.source_seq % self._stride:
            return
        self._stored[stamp.source_seq] = (stamp, encoded(picture))
        stored = self._stored
        while sum(len(data) for _, data in stored.values()) > STORED_BYTES and len(stored) > 1:
            self._stride *= 2
            stored = {seq: one for seq, one in stored.items() if seq % self._stride == 0}
        self._stored = stored

    def close(self) -> None:
        """Writes the pictures."""
        try:
            (self._folder / PICTURES).mkdir()
            writer = PacketWriter(self._folder / PICTURES)
            for seq, (stamp, data) in sorted(self._stored.items()):
                writer.append(
                    data, "png", seq, stamp.epoch, stamp.t_sensor_ns - (self._first_ns or 0), 0
                )
            writer.close()
            for name, picture in self._named.items():
                write_file(self._folder / f"{name}.png", encoded(picture))
        except OSError as error:
            self._lost(f"{self._folder}: {error.strerror}")
