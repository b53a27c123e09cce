"""The networks of engine "litert": faces in a picture, and the landmarks of one face."""

import math
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.eyes import HEAD_POINTS
from lfpipe.track.detector import FULL, Detection, Detector
from lfpipe.track.engine import Face
from lfpipe.track.network import Network, Roi, around, model_file, portable_warp, warp

SIZE_PX = 192  # side of the landmark network's picture
POINTS = 468  # of MediaPipe's face mesh


class FaceNetworks(Protocol):
    """What `LitertEngine` needs of networks; `lfpipe bench viewer` passes synthetic ones."""

    model: str
    """File names and versions, for `doctor`."""

    def detect(self, image: NDArray[np.uint8], region: Roi | None = None) -> list[Detection]:
        """Faces in uint8 (height, width, 3) BGR, or in a region of it; highest score first."""
        ...

    def detect_far(self, image: NDArray[np.uint8], region: Roi | None = None) -> list[Detection]:
        """The same, for small faces; slower."""
        ...

    def logit(self, image: NDArray[np.uint8], roi: Roi) -> float:
        """Logit of the confidence that roi shows an upright face."""
        ...

    def measure(
        self, image: NDArray[np.uint8], roi: Roi, min_confidence: float
    ) -> tuple[Face, Roi] | None:
        """The face in roi, at any lean, and its region in the next picture."""
        ...


class LitertNetworks:
    """Networks of the mediapipe wheel.

    portable: bit-identical eyes in every version of OpenCV, at the cost of 0.14 ms. Raises
    UserError if network files are missing or have another version.
    """

    def __init__(self, portable: bool = False) -> None:
        self._warp = portable_warp if portable else warp
        self._landmarks = Network(
            model_file("modules/face_landmark/face_landmark.tflite"), SIZE_PX, (POINTS * 3, 1)
        )
        self.model = self._landmarks.name
        self.detect = Detector(warp=self._warp).detect

    @cached_property
    def _far(self) -> Detector:
        return Detector(FULL, self._warp)

    def detect_far(self, image: NDArray[np.uint8], region: Roi | None = None) -> list[Detection]:
        return self._far.detect(image, region)

    def logit(self, image: NDArray[np.uint8], roi: Roi) -> float:
        return self._run(image, roi)[2]

    def _run(
        self, image: NDArray[np.uint8], roi: Roi
    ) -> tuple[NDArray[np.float64], NDArray[np.float32], float]:
        """Returns roi's matrix, the network's points in px of the crop, flat, and the logit of its
        confidence.
        """
        matrix = roi.matrix(SIZE_PX)
        points, logit = self._landmarks.run(
            roi.crop(image, matrix, SIZE_PX, cv2.BORDER_REPLICATE, self._warp)
        )
        return matrix, points, float(logit[0])

    def measure(
        self, image: NDArray[np.uint8], roi: Roi, min_confidence: float
    ) -> tuple[Face, Roi] | None:
        matrix, values, logit = self._run(image, roi)
        confidence = 1 / (1 + math.exp(-min(max(logit, -80.0), 80.0)))
        if confidence < min_confidence:
            return None
        mesh = values.reshape(POINTS, 3)
        (_, _, x), (_, _, y) = matrix.tolist()
        points = matrix[:, :1] * mesh[:, 0] + matrix[:, 1:2] * mesh[:, 1]  # (2, 468) px from (x, y)
        x0, y0 = np.minimum.reduce(points, axis=1).tolist()
        x1, y1 = np.maximum.reduce(points, axis=1).tolist()
        (lx, ly), (rx, ry), left, right, eye_distance_px, head_px = eye_points(
            points, mesh[:, 2], np.float32(roi.side_px / SIZE_PX)
        )
        edges = x0 + x, y0 + y, x1 + x, y1 + y
        region = around(edges, right, left)
        # narrower than a pixel, or NaN: no region for the next picture
        if not 1.0 <= region.side_px < math.inf:
            return None
        eyes_px = np.array(((lx + x, ly + y), (rx + x, ry + y)))
        return Face(
            eyes_px, confidence, edges, eye_distance_px, math.degrees(region.angle), head_px
        ), region


# The points of the face mesh around the eyes.
#
# The 468 points are those of MediaPipe's canonical face model.

# The 16 points of each eyelid contour. The viewer's own left eye:
# at larger x in an unmirrored picture.
LEFT_EYE = np.array(
    [263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466]
)
RIGHT_EYE = np.array([33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246])
Point = tuple[float, float]

EDGES = (10, 152, 234, 454)  # top of the forehead, chin, and the sides of the face

# outer corners of the eyes, right to left: defines the rotation of a face's region
EYE_LINE = (33, 263)
# corners and lower lid: the first of LEFT_EYE and RIGHT_EYE. A blink moves the upper lid by a third
# of an eye
_LIDS = 9
_KEY = np.concatenate([LEFT_EYE[:_LIDS], RIGHT_EYE[:_LIDS], EYE_LINE, HEAD_POINTS])
_HEAD = 2 * _LIDS + len(EYE_LINE)  # index of the first of HEAD_POINTS in _KEY
# From the mean of these points to that of all 16 in open eyes, in eye distances:
# upwards, and away from the nose. Medians over 60 pictures of 10 people (0.0355, 0.0073) and 429
# frames of a talking person (0.0370, 0.0062).
_RAISE, _SPREAD = 0.036, 0.0067


def eye_points(
    points: NDArray[np.floating], depth: NDArray[np.floating], scale: np.float32
) -> tuple[Point, Point, Point, Point, float, NDArray[np.float64]]:
    """(left eye, right eye, their outer corners, the eye distance in 3-D, the points of HEAD_POINTS
    (10, 3)), from points (2, 468), x and y of the mesh, and depth (468,), its unscaled z. A blink
    does not move them.

    A centre is the mean of the eye's corners and lower lid, shifted to the paper's centre: the mean
    of all 16 periocular points of an open eye.
    """
    keys = np.empty((3, len(_KEY)))
    points.take(_KEY, 1, keys[:2])
    keys[2] = depth.take(_KEY) * scale
    xs, ys, zs = keys.tolist()  # plain numbers from here: a numpy call after a pause costs 15 us
    lx = ly = lz = rx = ry = rz = 0.0
    for k in range(_LIDS):
        lx, ly, lz = lx + xs[k], ly + ys[k], lz + zs[k]
        rx, ry, rz = rx + xs[k + _LIDS], ry + ys[k + _LIDS], rz + zs[k + _LIDS]
    lx, ly, lz, rx, ry, rz = lx / _LIDS, ly / _LIDS, lz / _LIDS, rx / _LIDS, ry / _LIDS, rz / _LIDS
    dx, dy = lx - rx, ly - ry
    up_x, up_y, out_x, out_y = _RAISE * dy, -_RAISE * dx, _SPREAD * dx, _SPREAD * dy
    right = 2 * _LIDS
    left = 2 * _LIDS + 1
    eyes = (lx + up_x + out_x, ly + up_y + out_y), (rx + up_x - out_x, ry + up_y - out_y)
    eye_distance = (1 + 2 * _SPREAD) * math.sqrt(dx * dx + dy * dy + (lz - rz) ** 2)
    return *eyes, (xs[left], ys[left]), (xs[right], ys[right]), eye_distance, keys[:, _HEAD:].T
