"""The networks of engine "litert": faces in a picture, and the landmarks of one face."""

import math
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.detector import FULL, Detection, Detector
from lfpipe.track.engine import Face
from lfpipe.track.landmarks import eye_points
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
