"""Combines engine and filter: one call per frame. The stage runs this; it needs no processes."""

import logging
import math

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.eyes import Eyes, EyesRecord
from lfpipe.track.detector import SAME, overlap
from lfpipe.track.engine import Engine, Face
from lfpipe.track.filters import make_filter
from lfpipe.track.make_engine import make_engine
from lfpipe.track.smoothing import MAX_STEP_NS

log = logging.getLogger(__name__)

# Logits of the confidence: 20 for a face that nothing hides, 13 to 20 for turned heads, 1 to 10
# behind a hand.
SUREST, FALL, BACK, SURE = 20.0, 10.0, 4.0, 2.0
USUAL_S = 1.0  # time constant of a face's usual confidence: nothing is held for much longer
# in distances between the eyes: the most that a hand pulls a face; what nobody notices
NEAR, UNSEEN = 0.7, 0.1
# The same per second: a face that moved faster when it was seen clearly is not held. It leaves the
# picture or turns away; a hand comes before faces that rest.
HELD_SPEED = 1.0
NOWHERE: Eyes = (0.0, 0.0, 0.0, 0.0)


class OcclusionHold:
    """Whether something hides the face: its confidence falls, and landmarks follow a hand instead
    of the eyes.

    Then the eyes are held where they were before the confidence fell, unless the face was moving
    then, or moves by more than a hand can pull it.
    held: hold them. sure: the present frame is one to hold later.
    """

    def __init__(self) -> None:
        self.reset(0.0, (0.0, 0.0))

    def reset(self, sure: float, middle_px: tuple[float, float]) -> None:
        """Begins with the first frame of a track."""
        self._usual = sure
        self._sure_px = middle_px  # between the eyes
        self._moved = False  # when it was seen clearly
        self.held = False
        self.sure = True

    def update(
        self,
        sure: float,
        middle_px: tuple[float, float],
        eye_distance_px: float,
        dt_s: float,
        speed_px_s: float,
    ) -> bool:
        """Adds a frame; returns whether the face is elsewhere after it was held. sure: logit of its
        confidence. dt_s, speed_px_s: since and at the last frame.
        """
        self._usual = max(sure, self._usual + min(dt_s / USUAL_S, 1.0) * (sure - self._usual))
        off = math.dist(middle_px, self._sure_px) / max(eye_distance_px, 1.0)
        held = self.held
        hidden = sure < self._usual - (BACK if self.held else FALL)
        self.held = hidden and not self._moved and off < NEAR
        self.sure = sure > self._usual - SURE or (held and not self.held)
        if self.sure:
            self._sure_px = middle_px
            self._moved = speed_px_s > HELD_SPEED * eye_distance_px
        return held and not self.held and off > UNSEEN


class EyeTracker:
    """engine: finds faces; by default, the one that the settings name. seen: whether the last frame
    had a face. fault: which part gives numbers that cannot be used, in words; "" while all work.

    portable: see `LitertEngine`. device_latency_s: delay of camera and display. Raises UserError
    if an engine's libraries or models are missing.
    """

    def __init__(
        self,
        settings: Track,
        portable: bool = False,
        device_latency_s: float = 0.0,
        engine: Engine | None = None,
    ) -> None:
        self.engine = engine or make_engine(settings, portable)
        self._settings: tuple[Track, float] | None = None
        self.set(settings, device_latency_s)
        self._hidden = OcclusionHold()
        self._raw_px = self._position_px = self._velocity_px_s = self._sure_position_px = NOWHERE
        self._face: Face | None = None
        self._box_px = (0.0, 0.0, 0.0, 0.0)
        self._seen_ns = 0
        self._epoch = -1
        self._generation = 0
        self.seen = False
        self.fault = ""

    def set(self, settings: Track, device_latency_s: float = 0.0) -> None:
        """Replaces the filter, but not the engine."""
        if (settings, device_latency_s) != self._settings:
            self._settings = (settings, device_latency_s)
            self._filter = make_filter(settings, device_latency_s)
            self._holds = settings.filter == "predictive"
            self._averages = settings.filter == "mean"

    def reset(self) -> None:
        """Starts a new choice of the face."""
        self.engine.reset()
        self.seen = False

    def update(self, face: Face | None, t_sensor_ns: int, epoch: int = 0) -> bool:
        """Adds the engine's result for a frame. Returns whether a face was found or lost. epoch: a
        new value means a new run.

        An implausible face counts as none: an average would never forget it.
        """
        if face is not None and not face.plausible:
            log.info("implausible face: %s", face)
            self.fault = f"engine {self.engine.name} gives faces that cannot be"
            face = None
        elif face is not None:
            self.fault = ""
            self._follow(face, t_sensor_ns, epoch)
            if not math.isfinite(sum(self._position_px + self._velocity_px_s)):
                self.fault = "the filter gives eyes that are not finite"
                self._position_px = self._raw_px
                face = None
        self._face = face
        if face is None:
            self._velocity_px_s = NOWHERE  # hold the position: the motion is unknown
            if self._averages:
                self._filter.reset()  # the average must not mix positions before and after a loss
        changed = (face is not None) != self.seen
        self.seen = face is not None
        return changed

    def _follow(self, face: Face, t_sensor_ns: int, epoch: int) -> None:
        (lx, ly), (rx, ry) = face.eyes_px.tolist()
        middle_px = ((lx + rx) / 2, (ly + ry) / 2)
        confidence = min(max(face.confidence, 1e-9), 1 - 1e-10)
        sure = min(math.log(confidence / (1 - confidence)), SUREST)
        away_ns = t_sensor_ns - self._seen_ns
        # a hidden face's box is as wrong as its eyes
        same = self._hidden.held or overlap(self._box_px, face.box_px) > SAME
        if epoch != self._epoch or away_ns >= MAX_STEP_NS or not same:
            # earlier runs say nothing about this one
            self._epoch = epoch
            anew = True
            self._hidden.reset(sure, middle_px)
        else:
            eye_distance_px = face.eye_distance_px or math.dist((lx, ly), (rx, ry))
            speed_px_s = math.hypot(*self._velocity_px_s[:2])
            anew = self._hidden.update(
                sure, middle_px, eye_distance_px, max(away_ns, 0) / 1e9, speed_px_s
            )
        self._raw_px = (lx, ly, rx, ry)
        self._box_px = face.box_px
        self._seen_ns = t_sensor_ns
        if self._hidden.held and self._holds:  # the other filters are for comparison, as published
            self._position_px = self._sure_position_px
            self._velocity_px_s = NOWHERE
            return
        if anew:
            self._generation += 1
            self._filter.reset()
        position, velocity = self._filter.update(t_sensor_ns, face.eyes_px)
        ((a, b), (c, d)), ((u, v), (p, q)) = position.tolist(), velocity.tolist()
        self._position_px, self._velocity_px_s = (a, b, c, d), (u, v, p, q)
        if self._hidden.sure:
            self._sure_position_px = self._position_px

    def write(self, record: NDArray[np.void], image: NDArray[np.uint8]) -> None:
        """Fills a record of dtype EYES, except t_tracked_ns. image: the frame."""
        face = self._face
        height_px, width_px = image.shape[:2]
        eye_distance_px, confidence = (
            (face.eye_distance_px, face.confidence) if face is not None else (0.0, 0.0)
        )
        eyes = self._raw_px, self._position_px, self._velocity_px_s
        EyesRecord(
            *eyes, eye_distance_px, confidence, width_px, height_px, 0, self.seen, self._generation
        ).write(record)
        record["head_px"] = 0.0 if face is None or face.head_px is None else face.head_px
