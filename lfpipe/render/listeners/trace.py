"""Trace lines of presentations."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfpipe.config import SessionOptions
from lfpipe.config.quality import level_number
from lfpipe.files.trace import TraceFile
from lfpipe.render.presenter import Listener, Presentation
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.ring import StampKind


def trace_line(presentation: Presentation, method: str, level: int) -> dict[str, Any]:
    """The trace line of a presentation with eyes (docs/contracts.md). method, level: current."""
    eyes = presentation.eyes
    assert eyes is not None
    stamp = eyes.stamp
    raw_px = eyes.record.raw_px
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


class Trace(Listener):
    """Writes a line per presentation to the file of option "trace"."""

    def __init__(self, viewer: Viewer, began: Path | None, lost: Callable[[str], None]) -> None:
        """began: a file that the session wrote at its start; a restarted process continues a newer
        trace than that. lost: called once with the reason if a file ends early.
        """
        self._viewer = viewer
        self._began = began
        self._lost = lost
        self._path = ""
        self._file: TraceFile | None = None
        self._level = 0

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
            self._file.write(trace_line(presentation, self._viewer.method, self._level))

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
