"""Where else pictures go while somebody asks: the ring "pictures", the timeline, and what the viewer's eyes look at.

All three follow the session's options; nobody asking means no ring, no copy, no message.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.files.trace import TraceFile
from lfpipe.render.viewer import Look, Viewer
from lfpipe.transport import ring
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Stamp

LOOK_NS = 100 * MS_NS  # how often the look is told


class OptionalOutputs:
    """Call `follow` whenever options may have changed; the other calls cost next to nothing while nobody asks."""

    def __init__(self, context: Context, viewer: Viewer) -> None:
        self._context, self._viewer = context, viewer
        self._part, self._ring = "", None  # type: tuple[str, ring.Writer | None]
        self._path = ""
        self._timeline = TraceFile(None, self._lost)
        self._look_due_ns = 0

    def follow(self, options: SessionOptions, picture: NDArray[np.uint8] | None) -> None:
        """Opens and closes what options ask for. picture: the one on the screen, for a ring that is new."""
        part, path = options.pictures, options.timeline
        if part != self._part:
            if self._ring is not None:
                self._ring.close()
            self._part, self._ring = part, None
            if part:
                try:
                    self._ring = ring.Writer(self._context.spec.session.segment(part))
                except FileNotFoundError:
                    return  # given back before it was used
                self.picture(picture, None)
        if path != self._path:
            self._path = path
            self._timeline.close()
            self._timeline = TraceFile(Path(path) if path else None, self._lost)

    def _lost(self, why: str) -> None:
        self._context.emit("notice", text=why)

    @property
    def traced(self) -> bool:
        """Whether somebody wants the timeline."""
        return self._timeline.wanted

    def line(self, record: dict[str, Any]) -> None:
        """One object of the trace, for the timeline."""
        self._timeline.write(record)

    def picture(self, picture: NDArray[np.uint8] | None, stamp: Stamp | None) -> None:
        """A picture as it was just shown. One of another size than the ring's, just after another scene came, is left out."""
        if self._ring is None or picture is None or picture.shape != self._ring.shape:
            return
        np.copyto(self._ring.begin(), picture)
        if stamp is None:
            self._ring.publish(-1, 0, 0)
        else:
            self._ring.publish(stamp.source_seq, stamp.t_sensor_ns, stamp.t_read_ns, stamp.epoch)

    def look(self, look: Look, face: bool) -> None:
        """Tells the tap where the eyes are and which views they see, at most every LOOK_NS."""
        if self._ring is None or now_ns() < self._look_due_ns:
            return
        self._look_due_ns = now_ns() + LOOK_NS
        field, mapper = self._viewer.field, self._viewer.mapper
        self._context.emit(
            "look",
            face=face,
            eyes_px=look.eyes_px.tolist(),
            views=[list(look.left), list(look.right)],
            grid=[field.rows, field.cols],
            alpha_px=mapper.alpha_px if mapper else 0.0,
            centre_px=list(mapper.centre_px) if mapper else [0.0, 0.0],
            method=self._viewer.method,
        )

    def close(self) -> None:
        """Ends the timeline; the ring ends with the process."""
        self._timeline.close()
