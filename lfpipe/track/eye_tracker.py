"""Combines engine and filter: one call per frame. The stage runs this; it needs no processes."""

import logging
import math

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.eyes import MAX_STEP_NS, Eyes, EyesRecord
from lfpipe.track.detector import SAME_OVERLAP, overlap
from lfpipe.track.engine import Engine, Face, make_engine
from lfpipe.track.filters.base import make_filter

log = logging.getLogger(__name__)
NOWHERE: Eyes = (0.0, 0.0, 0.0, 0.0)

# Logits of the confidence: 20 for an unoccluded face, 13 to 20 for turned heads, 1 to 10 behind a
# hand. Drops are relative to the face's usual confidence.
HIDE_DROP, RELEASE_DROP = 10.0, 4.0  # a face is held below the first, released above the second
TRUST_DROP = 2.0  # below it, a frame's position may be held later
USUAL_S = 1.0  # time constant of the usual confidence: nothing is held for much longer
# Eye distances: maximum displacement of both eyes by a hand, and minimum difference between them:
# a hand pulls the eye that it covers, and darkness none.
MAX_PULL, MIN_PULL = 0.4, 0.1
# Eye distances per second: a face that moved faster while unoccluded is not held. Hands pull faces
# at rest by up to as much before the confidence falls.
MAX_HELD_SPEED = 0.5


class OcclusionHold:
    """Detects occlusion of the face: its confidence falls, and landmarks follow a hand.

    The eyes are then held at their last position before the confidence fell, unless the face moves
    by more than a hand can pull it. Of a face that was moving, the eye that has moved less places
    both where a hand pulls the other one; otherwise it is followed.
    """

    def __init__(self) -> None:
        self.reset(0.0, NOWHERE)

    def reset(self, logit: float, eyes_px: Eyes) -> None:
        """Starts with the first frame of a track.

        logit: of its confidence.
        """
        self._usual = logit
        self._trusted_px = eyes_px
        self._moved = False  # while it was unoccluded
        self._pulled = False  # whether a hand pulls one eye of a face that was moving
        self.eyes_px = eyes_px
        """To be filtered, unless they are held."""
        self.held = False
        """Whether to hold the eyes."""
        self.trusted = True
        """Whether the eyes of the current frame may be held later."""

    def update(
        self,
        logit: float,
        eyes_px: Eyes,
        eye_distance_px: float,
        dt_s: float,
        speed_px_s: float,
    ) -> bool:
        """Adds a frame; returns whether a hold has just ended: the filter is then reset.

        dt_s: since the last frame. speed_px_s: at the last frame.
        """
        self._usual = max(logit, self._usual + min(dt_s / USUAL_S, 1.0) * (logit - self._usual))
        lx, ly, rx, ry = self._trusted_px
        left, right = (eyes_px[0] - lx, eyes_px[1] - ly), (eyes_px[2] - rx, eyes_px[3] - ry)
        x, y = min(left, right, key=lambda step: math.hypot(*step))
        was_held = self.held
        hidden = logit < self._usual - (RELEASE_DROP if was_held or self._pulled else HIDE_DROP)
        unit_px = max(eye_distance_px, 1.0)
        self.held = hidden and not self._moved and math.hypot(x, y) < MAX_PULL * unit_px
        apart = math.dist(left, right) / unit_px
        self._pulled = hidden and self._moved and MIN_PULL < apart < MAX_PULL
        self.eyes_px = (lx + x, ly + y, rx + x, ry + y) if self._pulled else eyes_px
        released = was_held and not self.held
        self.trusted = logit > self._usual - TRUST_DROP or released
        if self.trusted:
            self._trusted_px = eyes_px
            self._moved = speed_px_s > MAX_HELD_SPEED * eye_distance_px
        return released


class EyeTracker:
    """Follows one viewer's eyes from frame to frame.

    portable: see `LitertNetworks`. device_latency_s: delay of camera and display. engine: the
    default is that of the settings. Raises UserError if its libraries or models are missing.
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
        self._occlusion = OcclusionHold()
        self._raw_px = self._position_px = self._velocity_px_s = self._trusted_position_px = NOWHERE
        self._face: Face | None = None
        self._box_px = (0.0, 0.0, 0.0, 0.0)
        self._seen_ns = 0
        self._epoch = -1
        self._generation = 0
        self.seen = False
        """Whether the last frame had a face."""
        self.fault = ""
        """The part that returns unusable values; "" if there is none."""

    def set(self, settings: Track, device_latency_s: float = 0.0) -> None:
        """Replaces the filter, but not the engine."""
        if (settings, device_latency_s) != self._settings:
            self._settings = (settings, device_latency_s)
            self._filter = make_filter(settings, device_latency_s)

    def reset(self) -> None:
        """Starts a new choice of the face."""
        self.engine.reset()
        self.seen = False

    def update(self, face: Face | None, t_sensor_ns: int, epoch: int = 0) -> bool:
        """Adds the engine's result for a frame. Returns whether a face was found or lost. epoch: a
        new value means a new run.

        Implausible faces are discarded: one NaN would persist in the running averages.
        """
        if face is not None and not face.plausible:
            log.info("implausible face: %s", face)
            self.fault = f"engine {self.engine.name} returned an impossible face"
            face = None
        elif face is not None:
            self.fault = ""
            self._follow(face, t_sensor_ns, epoch)
            if not math.isfinite(sum(self._position_px + self._velocity_px_s)):
                self.fault = "the filter returned NaN or infinity"
                self._position_px = self._raw_px
                face = None
        self._face = face
        if face is None:
            self._velocity_px_s = NOWHERE  # hold the position: the motion is unknown
            if self._filter.restarts_after_loss:
                self._filter.reset()
        changed = (face is not None) != self.seen
        self.seen = face is not None
        return changed

    def _follow(self, face: Face, t_sensor_ns: int, epoch: int) -> None:
        (lx, ly), (rx, ry) = face.eyes_px.tolist()
        self._raw_px = eyes_px = lx, ly, rx, ry
        confidence = min(max(face.confidence, 1e-9), 1 - 2e-9)  # logits of -20 to 20
        logit = math.log(confidence / (1 - confidence))
        away_ns = t_sensor_ns - self._seen_ns
        # the box of an occluded face is as wrong as its eyes
        same = self._occlusion.held or overlap(self._box_px, face.box_px) > SAME_OVERLAP
        if epoch != self._epoch or away_ns >= MAX_STEP_NS or not same:
            # earlier runs are unrelated to this one
            self._epoch = epoch
            self._generation += 1
            self._filter.reset()
            self._occlusion.reset(logit, eyes_px)
        else:
            eye_distance_px = face.eye_distance_px or math.dist((lx, ly), (rx, ry))
            speed_px_s = math.hypot(*self._velocity_px_s[:2])
            if self._occlusion.update(
                logit, eyes_px, eye_distance_px, max(away_ns, 0) / 1e9, speed_px_s
            ):
                self._filter.reset()  # of the same face: its generation stays
        self._box_px = face.box_px
        self._seen_ns = t_sensor_ns
        if self._occlusion.held and self._filter.holds_when_hidden:
            self._position_px = self._trusted_position_px
            self._velocity_px_s = NOWHERE
            return
        position, velocity = self._filter.update(
            t_sensor_ns, np.reshape(self._occlusion.eyes_px, (2, 2))
        )
        ((a, b), (c, d)), ((u, v), (p, q)) = position.tolist(), velocity.tolist()
        self._position_px, self._velocity_px_s = (a, b, c, d), (u, v, p, q)
        if self._occlusion.trusted:
            self._trusted_position_px = self._position_px

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
