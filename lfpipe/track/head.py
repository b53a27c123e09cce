"""The viewer's head for other programs: positions in mm in front of the screen, and rotation.

Axes: the origin is the middle of the picture on the screen; x points to the viewer's right, y up, z
from the screen to the viewer. A viewer who looks straight at the screen looks along -z, like the
camera in OpenGL and three.js. The depth follows from the distance between the eyes (`CameraPose`);
one eye of a turned head is further away than the other.

The rotation fits MediaPipe's canonical face model to the network's points (Kabsch, Acta Cryst. A32,
1976), at points that jaw and mouth do not move. The mesh assumes parallel camera rays, so the fit
is relative to the line of sight from the camera to the head.
"""

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config
from lfpipe.config.camera_pose import CameraPose
from lfpipe.eyes import MAX_STEP_NS, MIN_EYE_DISTANCE_PX, extrapolated, low_pass_gain

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
