"""Combines engine and filter: one call per frame. The stage runs this; it needs no processes. And
the viewer's head for other programs: positions in mm in front of the screen, and rotation.

Axes: the origin is the middle of the picture on the screen; x points to the viewer's right, y up, z
from the screen to the viewer. A viewer who looks straight at the screen looks along -z, like the
camera in OpenGL and three.js. The depth follows from the distance between the eyes (`CameraPose`);
one eye of a turned head is further away than the other.

The rotation fits MediaPipe's canonical face model to the network's points (Kabsch, Acta Cryst. A32,
1976), at points that jaw and mouth do not move. The mesh assumes parallel camera rays, so the fit
is relative to the line of sight from the camera to the head.
"""

import logging
import math

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config, Track
from lfpipe.config.camera_pose import CameraPose
from lfpipe.eyes import (
    MAX_STEP_NS,
    MIN_EYE_DISTANCE_PX,
    Eyes,
    EyesRecord,
    extrapolated,
    low_pass_gain,
)
from lfpipe.track.engine import Engine, Face, make_engine
from lfpipe.track.filters.base import make_filter
from lfpipe.track.network import SAME_OVERLAP, overlap

Point = tuple[float, float, float]

# time constant of the depth: the eye distance is noisier than the position
DEPTH_S = 0.1

# The points of `lfpipe.eyes.HEAD_POINTS` in the canonical model, cm: x to the face's left, y up, z
# out of the face.
_MODEL_CM = (
    (0.0, -1.126865, 7.475604),
    (0.0, 8.261778, 4.481535),
    (-4.445859, 2.663991, 3.173422),
    (-1.856432, 2.585245, 3.757904),
    (1.856432, 2.585245, 3.757904),
    (4.445859, 2.663991, 3.173422),
    (-7.743095, 2.364999, -2.005167),
    (7.743095, 2.364999, -2.005167),
    (-7.664182, 0.673132, -2.435867),
    (7.664182, 0.673132, -2.435867),
)
# in the picture's axes: right, down, away from the camera
MODEL = np.array(_MODEL_CM) * (1.0, -1.0, -1.0)
_CENTRED = MODEL - MODEL.mean(axis=0)  # its rows sum to 0, so the points need not be centred


@attrs.frozen(kw_only=True)
class Head:
    """Position and rotation of a head. A head that faces along -z has angles of 0; yaw, pitch and
    roll are applied in this order about intrinsic axes.
    """

    left_mm: Point
    """The viewer's own left eye."""
    right_mm: Point
    """The viewer's own right eye."""
    position_mm: Point
    """The midpoint of the eyes."""
    yaw_deg: float
    """To the viewer's right."""
    pitch_deg: float
    """Up."""
    roll_deg: float
    """To the right shoulder."""


class HeadEstimator:
    """Converts records of ring "eyes" to heads; smooths the depth over DEPTH_S."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self._eye_distance_px = 0.0
        self._t_ns = self._generation = 0

    def update(self, record: NDArray[np.void], t_sensor_ns: int) -> None:
        """Adds a record of dtype EYES and its frame's stamp, each once and in order."""
        if not record["face"]:
            return
        eye_distance_px = float(record["eye_distance_px"]) or math.dist(
            *record["filtered_px"].tolist()
        )
        if not MIN_EYE_DISTANCE_PX <= eye_distance_px < math.inf:
            return
        step_ns = t_sensor_ns - self._t_ns
        generation = int(record["generation"])
        fresh = (
            not self._eye_distance_px
            or not 0 <= step_ns < MAX_STEP_NS
            or generation != self._generation
        )
        gain = 1.0 if fresh else low_pass_gain(step_ns / 1e9, DEPTH_S)
        self._eye_distance_px += gain * (eye_distance_px - self._eye_distance_px)
        self._t_ns = t_sensor_ns
        self._generation = generation

    def head(self, record: NDArray[np.void], prediction_ns: int = 0) -> Head | None:
        """The head in the last record, its eyes predicted prediction_ns ahead; None without a
        face.
        """
        if not record["face"] or not self._eye_distance_px:
            return None
        eyes_px = extrapolated(record["filtered_px"], record["velocity_px_s"], prediction_ns)
        if not np.isfinite(eyes_px).all():
            return None
        pose = CameraPose.configured(
            self.config, (int(record["width_px"]), int(record["height_px"]))
        )
        return _head(
            pose,
            np.asarray(eyes_px, np.float64),
            self._eye_distance_px,
            head_rotation(record["head_px"]),
        )


def head_rotation(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """The rotation (3, 3) of the canonical model, in the picture's axes, that fits points (10, 3),
    `HEAD_POINTS` in any unit: right, down, away from the camera. The identity for a face that looks
    along the line of sight, and for unknown points (not finite, or all 0).
    """
    moved = np.asarray(points, np.float64)
    if not moved.any() or not np.isfinite(moved).all():
        return np.eye(3)
    u, _, vt = np.linalg.svd((moved / np.abs(moved).max()).T @ _CENTRED)
    if np.linalg.det(u @ vt) < 0:
        u[:, 2] *= -1  # a reflection would fit better, but is impossible
    return np.asarray(u @ vt, np.float64)


# between the picture's axes (right, down, ahead) and those of a viewer who faces it
_FLIP = np.diag([-1.0, -1.0, 1.0])


def _head(
    pose: CameraPose,
    eyes_px: NDArray[np.float64],
    eye_distance_px: float,
    rotation: NDArray[np.float64],
) -> Head:
    # of the eyes, in the camera's axes
    rays = np.column_stack([(eyes_px - pose.middle_px) / pose.focal_px, np.ones(2)])
    turned = _along(rays.mean(axis=0)) @ rotation  # of the head in the camera's axes
    # additional distance of the left eye over the point between them
    aside_mm = turned[2, 0] * pose.eyes_mm / 2
    depths_mm = pose.focal_px * pose.eyes_mm / eye_distance_px + np.array([[aside_mm], [-aside_mm]])
    c = math.cos(pose.tilt)
    s = math.sin(pose.tilt)
    to_screen = np.array([[-1.0, 0, 0], [0, -c, -s], [0, -s, c]])
    eyes_mm = (rays * depths_mm) @ to_screen.T + (0.0, pose.above_mm, 0.0)
    left_mm, right_mm, between_mm = (
        tuple(point) for point in (*eyes_mm.tolist(), eyes_mm.mean(axis=0).tolist())
    )
    r = (to_screen @ turned @ _FLIP).tolist()
    return Head(
        left_mm=left_mm,
        right_mm=right_mm,
        position_mm=between_mm,
        yaw_deg=-math.degrees(math.atan2(r[0][2], r[2][2])),
        pitch_deg=math.degrees(math.asin(min(max(-r[1][2], -1.0), 1.0))),
        roll_deg=-math.degrees(math.atan2(r[1][0], r[1][1])),
    )


def _along(ray: NDArray[np.float64]) -> NDArray[np.float64]:
    """The smallest rotation from the camera's axis to a ray."""
    x, y, z = ray / np.linalg.norm(ray)
    k = 1 / (1 + z)
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]])


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
        self.is_holding = False
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
        was_holding = self.is_holding
        hidden = logit < self._usual - (RELEASE_DROP if was_holding or self._pulled else HIDE_DROP)
        unit_px = max(eye_distance_px, 1.0)
        self.is_holding = hidden and not self._moved and math.hypot(x, y) < MAX_PULL * unit_px
        apart = math.dist(left, right) / unit_px
        self._pulled = hidden and self._moved and MIN_PULL < apart < MAX_PULL
        self.eyes_px = (lx + x, ly + y, rx + x, ry + y) if self._pulled else eyes_px
        released = was_holding and not self.is_holding
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
        self.has_face = False
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
        self.has_face = False

    def update(self, face: Face | None, t_sensor_ns: int, epoch: int = 0) -> bool:
        """Adds the engine's result for a frame. Returns whether a face was found or lost. epoch: a
        new value means a new run.

        Implausible faces are discarded: one NaN would persist in the running averages.
        """
        if face is not None and not face.plausible:
            logging.getLogger(__name__).info("implausible face: %s", face)
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
        changed = (face is not None) != self.has_face
        self.has_face = face is not None
        return changed

    def _follow(self, face: Face, t_sensor_ns: int, epoch: int) -> None:
        (lx, ly), (rx, ry) = face.eyes_px.tolist()
        self._raw_px = eyes_px = lx, ly, rx, ry
        confidence = min(max(face.confidence, 1e-9), 1 - 2e-9)  # logits of -20 to 20
        logit = math.log(confidence / (1 - confidence))
        away_ns = t_sensor_ns - self._seen_ns
        # the box of an occluded face is as wrong as its eyes
        same = self._occlusion.is_holding or overlap(self._box_px, face.box_px) > SAME_OVERLAP
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
        if self._occlusion.is_holding and self._filter.holds_when_hidden:
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
            *eyes,
            eye_distance_px,
            confidence,
            width_px,
            height_px,
            0,
            self.has_face,
            self._generation,
        ).write(record)
        record["head_px"] = 0.0 if face is None or face.head_px is None else face.head_px
