"""Engine "litert": MediaPipe's landmark network run in this thread, on a region of interest kept from picture to picture.

The same network, regions and thresholds as the FaceMesh graph, without its scheduler: the detector runs for the first
face and after a loss only. Where FaceMesh takes the surest face, this takes the viewer's (`choice.py`).
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.choice import Viewer
from lfpipe.track.detector import Detection, Detector
from lfpipe.track.engine import Face
from lfpipe.track.iris import Irises
from lfpipe.track.landmarks import FRONTAL, TURN, iris_diameter, key_points, turn
from lfpipe.track.network import Network, model_file
from lfpipe.track.picture import as_bgr8
from lfpipe.track.roi import Roi, around, fill, portable_warp, warp

SIZE_PX = 192
POINTS = 468
MIN_CONFIDENCE = 0.5


class LitertEngine:
    """refine: eye centres are those of the irises, at the price of two small networks more. portable: the same eyes to the last
    bit in every version of OpenCV, at the price of 0.14 ms.

    Raises UserError where mediapipe's network files are missing or of another version.
    """

    name = "litert"

    def __init__(self, refine: bool = False, portable: bool = False) -> None:
        self._warp = portable_warp if portable else warp
        path = model_file("modules/face_landmark/face_landmark.tflite")
        self._network = Network(path, (1, SIZE_PX, SIZE_PX, 3), (POINTS * 3, 1))
        self._detector = Detector(self._warp)
        self._irises = Irises(self._warp) if refine else None
        self.model = self._network.name + (f" + {self._irises.model}" if self._irises else "")
        self._roi: Roi | None = None
        self._size: tuple[int, ...] = ()
        self._viewer = Viewer()

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        """See Engine.detect; also takes grey, BGRA and 16-bit pictures. Raises UserError for other arrays."""
        bgr = as_bgr8(image)
        if bgr.shape[:2] != self._size:  # px of another picture mean nothing here
            self._size = bgr.shape[:2]
            self.reset()
        face = self._followed(bgr, self._roi) if self._roi else self._found(bgr)
        if face and self._viewer.due:
            back = self._viewer.back(self._detector.detect(bgr), face.box_px)
            face = (self._followed(bgr, _region(back)) if back else None) or face
        if face is None:
            self._roi = None
        else:
            self._viewer.followed(face.box_px)
        return face

    def reset(self) -> None:
        self._roi, self._viewer = None, Viewer()

    def close(self) -> None:
        self.reset()

    def _found(self, bgr: NDArray[np.uint8]) -> Face | None:
        """A face anywhere in the picture."""
        found = self._detector.detect(bgr)
        if not found:
            return None
        return self._followed(bgr, _region(self._viewer.choose(found, bgr.shape[1], bgr.shape[0])))

    def _followed(self, bgr: NDArray[np.uint8], roi: Roi) -> Face | None:
        """The face in roi; its own region becomes the one for the next picture."""
        crop = roi.crop(bgr, SIZE_PX, cv2.BORDER_REPLICATE, self._warp)
        fill(self._network.input, crop, 0.0, 1.0)
        values, logit = self._network.run()
        confidence = 1 / (1 + math.exp(-min(max(float(logit[0]), -80.0), 80.0)))
        matrix, mesh = roi.matrix(SIZE_PX), values.reshape(POINTS, 3)
        x, y = matrix[:, 2].tolist()
        points = matrix[:, :1] * mesh[:, 0] + matrix[:, 1:2] * mesh[:, 1]  # (2, 468) px from (x, y)
        (x0, y0), (x1, y1) = points.min(axis=1).tolist(), points.max(axis=1).tolist()
        left, right, start, end = ((px + x, py + y) for px, py in key_points(points))
        edges = x0 + x, y0 + y, x1 + x, y1 + y
        region = around(edges, start, end)
        # not one pixel wide, or not a number: nothing to look at next time
        if confidence < MIN_CONFIDENCE or not 1.0 <= region.side_px < math.inf:
            return None
        self._roi = region
        if self._irises is None:
            return Face(np.array((left, right)), confidence, edges)
        mesh_px = points.T + matrix[:, 2]
        irises = self._irises.find(bgr, mesh_px)
        frontal = abs(turn(mesh_px[list(TURN)])) <= FRONTAL
        return Face(irises[:, 0], confidence, edges, iris_diameter(irises) if frontal else 0.0)


def _region(face: Detection) -> Roi:
    return around(face.box_px, face.points_px[0], face.points_px[1])
