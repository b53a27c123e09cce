"""Face engines find the eyes in a picture: their protocol, what they return, and the networks of
engine "litert": faces in a picture, and the landmarks of one face.
"""

import contextlib
import math
import os
from functools import cached_property
from typing import Any, Protocol

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.errors import UserError
from lfpipe.eyes import HEAD_POINTS, MIN_EYE_DISTANCE_PX, is_plausible_px
from lfpipe.host.terminal import quiet_stderr
from lfpipe.plugins import ENGINES, make
from lfpipe.track.network import (
    FULL,
    Detection,
    Detector,
    Network,
    Roi,
    around,
    model_file,
    portable_warp,
    warp,
)

# Eye distance over the longer side of the face: 0.3 to 0.5 in faces, 1 for a bad fit.
MAX_EYE_DISTANCE = 1.5


@attrs.frozen(eq=False)
class Face:
    """One face, in px of the picture given."""

    eyes_px: NDArray[np.float64]
    """float64 (2, 2): [[left x, y], [right x, y]] of the viewer's own eyes."""
    confidence: float
    """0 to 1."""
    box_px: tuple[float, float, float, float]
    """(x0, y0, x1, y1)."""
    eye_distance_px: float = 0.0
    """Distance between the eyes as if the head were not turned; 0: unknown."""
    lean_deg: float = 0.0
    """Lean towards the shoulder, clockwise in the picture."""
    head_px: NDArray[np.float64] | None = None
    """float (10, 3): `lfpipe.eyes.HEAD_POINTS`, right, down, away from the camera; None: unknown.
    """

    @property
    def plausible(self) -> bool:
        """Whether all values are finite and consistent; if not, treat the frame as having no
        face.
        """
        (lx, ly), (rx, ry) = self.eyes_px.tolist()
        x0, y0, x1, y1 = self.box_px
        if not is_plausible_px(lx, ly, rx, ry, x0, y0, x1, y1, self.eye_distance_px):
            return False
        max_px = MAX_EYE_DISTANCE * max(x1 - x0, y1 - y0)
        distances_px = math.hypot(lx - rx, ly - ry), self.eye_distance_px or MIN_EYE_DISTANCE_PX
        return 0 <= self.confidence <= 1 and all(
            MIN_EYE_DISTANCE_PX <= distance_px <= max_px for distance_px in distances_px
        )


class Engine(Protocol):
    """Finds the viewer's face in each picture, and follows it."""

    name: str
    model: str
    """File name and version, for `doctor`."""
    rotated_deg: int
    """Clockwise rotation of the picture that would make detected faces upright; 0: none needed."""

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        """The viewer's face in uint8 (height, width, 3) BGR, or None.

        The engine keeps its region of interest between calls.
        """

    def examine(self, image: NDArray[np.uint8]) -> None:
        """Searches the last picture of `detect` for other faces, about once a second.

        Call it when there is time.
        """

    def reset(self) -> None:
        """Stops following; the next picture starts a new choice."""

    def close(self) -> None: ...


def make_engine(track: Track, portable: bool = False) -> Engine:
    """The engine that track names, ready. Its libraries are imported only now. portable: see
    `LitertNetworks`.

    Raises UserError if its libraries or models are missing or have another version.
    """
    name: str = track.engine
    if name == "litert":
        from lfpipe.track.litert_engine import LitertEngine

        return LitertEngine(LitertNetworks(portable))
    if name == "mediapipe":
        return MediapipeEngine()
    engine: Engine = make(ENGINES, name, track)
    return engine


SIZE_PX = 192  # side of the landmark network's picture
POINTS = 468  # of MediaPipe's face mesh


class FaceNetworks(Protocol):
    """What `LitertEngine` needs of networks; `lfpipe bench viewer` passes synthetic ones."""

    model: str
    """File names and versions, for `doctor`."""

    def detect(self, image: NDArray[np.uint8], region: Roi | None = None) -> list[Detection]:
        """Faces in uint8 (height, width, 3) BGR, or in a region of it; highest score first."""

    def detect_far(self, image: NDArray[np.uint8], region: Roi | None = None) -> list[Detection]:
        """The same, for small faces; slower."""

    def logit(self, image: NDArray[np.uint8], roi: Roi) -> float:
        """Logit of the confidence that roi shows an upright face."""

    def measure(
        self, image: NDArray[np.uint8], roi: Roi, min_confidence: float
    ) -> tuple[Face, Roi] | None:
        """The face in roi, at any lean, and its region in the next picture."""


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


_BLANK = np.zeros((64, 64, 3), np.uint8)


class MediapipeEngine:
    """FaceMesh of one face on the CPU.

    The graph reports no score, so confidence is 1. It chooses among several faces itself.
    Raises UserError if mediapipe is missing or has no FaceMesh.
    """

    name = "mediapipe"
    rotated_deg = 0

    def __init__(self) -> None:
        os.environ.setdefault("GLOG_minloglevel", "2")
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        try:
            import mediapipe  # takes half a second, so only if this engine is used

            version = str(getattr(mediapipe, "__version__", "unknown"))
            make: Any = mediapipe.solutions.face_mesh.FaceMesh
        except (ImportError, AttributeError) as error:
            raise UserError(
                f"track.engine = mediapipe: this installation has no FaceMesh ({error})",
                "set track.engine=litert, which runs the same landmark network, or install"
                " mediapipe==0.10.21, the last version with FaceMesh (up to Python 3.12); the"
                " FaceLandmarker of newer ones cannot run its networks",
            ) from None
        self.model = f"FaceMesh, mediapipe {version}"
        self._eyes = LEFT_EYE.tolist(), RIGHT_EYE.tolist()
        self._noisy = True  # the graph logs at its start, first picture and first face
        with quiet_stderr():
            self._mesh: Any = make(max_num_faces=1, refine_landmarks=False)
            self._mesh.process(_BLANK)

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        with quiet_stderr() if self._noisy else contextlib.nullcontext():
            faces = self._mesh.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB)).multi_face_landmarks
        if not faces:
            return None
        self._noisy = False
        size_px = np.array([image.shape[1], image.shape[0], image.shape[1]])
        marks = faces[0].landmark

        def points(*numbers: int) -> NDArray[np.float64]:
            """(n, 3) px. Each access calls protobuf: reading all 468 would take 0.4 ms."""
            return np.asarray(
                np.array([(marks[j].x, marks[j].y, marks[j].z) for j in numbers]) * size_px,
                np.float64,
            )

        eyes = np.stack([points(*numbers)[:, :2] for numbers in self._eyes])
        centres = eyes.mean(axis=1)
        edges = points(*EDGES)
        head_px = points(*HEAD_POINTS)
        right, left = (
            np.array((marks[j].x, marks[j].y * size_px[1] / size_px[0], marks[j].z))
            for j in EYE_LINE
        )
        flat = max(float(np.hypot(*(left - right)[:2])), 1e-9)
        eye_distance_px = (
            float(np.hypot(*(centres[0] - centres[1]))) * float(np.linalg.norm(left - right)) / flat
        )
        (x0, y0), (x1, y1) = edges[:, :2].min(axis=0).tolist(), edges[:, :2].max(axis=0).tolist()
        return Face(centres, 1.0, (x0, y0, x1, y1), eye_distance_px, head_px=head_px)

    def examine(self, image: NDArray[np.uint8]) -> None:
        """Does nothing: the graph keeps following its face."""

    def reset(self) -> None:
        with quiet_stderr():
            self._mesh.reset()
            self._mesh.process(_BLANK)

    def close(self) -> None:
        self._mesh.close()
