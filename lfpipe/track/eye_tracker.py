"""Combines engine, filter and the viewer's eye distance: one call per frame. The stage runs this; it needs no processes."""

import logging

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.track.engine import Face
from lfpipe.track.engines import make_engine
from lfpipe.track.eye_distance import EyeDistance
from lfpipe.track.filters import make_filter
from lfpipe.track.selector import same_place
from lfpipe.track.smoothing import MAX_STEP_NS

log = logging.getLogger(__name__)


class EyeTracker:
    """engine: finds faces. seen: whether the last frame had a face.

    portable: see `LitertEngine`. Raises UserError if an engine's libraries or models are missing.
    """

    def __init__(self, settings: Track, portable: bool = False) -> None:
        self.engine = make_engine(settings, portable)
        self._settings, self._filter, self._apart = settings, make_filter(settings), EyeDistance()
        self._raw_px = self._position_px = self._velocity_px_s = np.zeros((2, 2))
        self._face: Face | None = None
        self._box_px, self._seen_ns = (0.0, 0.0, 0.0, 0.0), 0
        self._epoch, self._generation = -1, 0
        self.seen = False

    def set(self, settings: Track) -> None:
        """Replaces the filter, but not the engine."""
        if settings != self._settings:
            self._settings, self._filter = settings, make_filter(settings)

    def reset(self) -> None:
        """Starts a new choice of the face."""
        self.engine.reset()
        self.seen = False

    def update(self, face: Face | None, t_sensor_ns: int, epoch: int = 0) -> bool:
        """Adds the engine's result for a frame. Returns whether a face was found or lost. epoch: a new value means a new run.

        An implausible face counts as none: whoever averages what follows would never forget it.
        """
        if face is not None and not face.plausible:
            log.debug("implausible face: %s", face)
            face = None
        self._face = face
        if face is not None:
            away_ns = t_sensor_ns - self._seen_ns
            if epoch != self._epoch or away_ns >= MAX_STEP_NS or not same_place(self._box_px, face.box_px):
                self._epoch, self._generation = epoch, self._generation + 1  # earlier runs say nothing about this one
                self._filter.reset()
                self._apart.reset()
            self._apart.update(t_sensor_ns, face)
            self._raw_px, self._box_px, self._seen_ns = face.eyes_px, face.box_px, t_sensor_ns
            self._position_px, self._velocity_px_s = self._filter.update(t_sensor_ns, face.eyes_px)
        else:
            self._velocity_px_s = np.zeros((2, 2))  # hold the position: the motion is unknown
            if self._settings.filter == "mean":
                self._filter.reset()  # the average must not mix positions before and after a loss
        changed, self.seen = (face is not None) != self.seen, face is not None
        return changed

    def write(self, record: NDArray[np.void], image: NDArray[np.uint8]) -> None:
        """Fills a record of dtype EYES, except t_tracked_ns. image: the frame."""
        face = self._face
        record["raw_px"], record["filtered_px"] = self._raw_px, self._position_px
        record["velocity_px_s"] = self._velocity_px_s
        record["apart_px"] = face.apart_px if face is not None else 0.0
        record["head_px"] = face.head_px if face is not None and face.head_px is not None else 0.0
        record["confidence"] = face.confidence if face is not None else 0.0
        record["width_px"], record["height_px"] = image.shape[1], image.shape[0]
        record["face"], record["generation"], record["eyes_mm"] = self.seen, self._generation, self._apart.mm
