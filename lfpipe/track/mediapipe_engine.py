"""Engine "mediapipe": MediaPipe's FaceMesh graph, as the paper uses it."""

import contextlib
import os
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.eyes import HEAD_POINTS
from lfpipe.host.terminal import quiet_stderr
from lfpipe.track.engine import Face
from lfpipe.track.face_networks import EDGES, EYE_LINE, LEFT_EYE, RIGHT_EYE

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
