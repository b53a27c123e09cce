"""Engine "litert": MediaPipe's landmark network run in this thread, on a region of interest that follows the face.

The same network and regions as the FaceMesh graph, without its scheduler. A detector runs for the first face, after a loss, and
about once a second in addition. FaceMesh takes the face with the highest score; this engine takes the viewer's (`selector.py`).
If the landmark network rejects a candidate, it tries the next.
"""

import math

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.eyes import HEAD_POINTS
from lfpipe.track.detector import FULL, Detection, Detector
from lfpipe.track.engine import Face
from lfpipe.track.iris import Irises
from lfpipe.track.landmarks import FRONTAL, TURN, eye_points, iris_diameter, turn
from lfpipe.track.network import Network, model_file
from lfpipe.track.picture import as_bgr8
from lfpipe.track.roi import Roi, around, fill, portable_warp, warp
from lfpipe.track.selector import FaceSelector

SIZE_PX = 192
POINTS = 468
_HEAD = np.array(HEAD_POINTS)
# In distances between the eyes. A gaze moves both irises off the middle of the lids equally, and only as far as the lids allow.
# If the two irises disagree, glasses or glare hide them, and the lids are the better estimate.
APART, ASIDE = 0.06, 0.13
FOUND = 0.5  # confidence that a new face needs
FOUND_FAR = 0.9  # the same for a small face: its detector has many false alarms, and real faces get high confidence
KEPT = 0.2  # confidence that a followed face needs: a hand in front of it lowers confidence more than accuracy
CANDIDATES = 6  # faces per picture that the landmark network tries, 1.3 ms each
FAR_EVERY = 8  # pictures without a face between runs of the full-range detector (10 ms each)
UPRIGHT_DEG = 80.0  # no head leans further; such a face is in a rotated picture
LEANING_DEG, REPEATS = 30.0, 4  # a new face that leans further is measured again, at most REPEATS times
QUARTERS = (math.pi, math.pi / 2, -math.pi / 2)
ROTATED_FACES = 3  # number of such faces before the hint appears


class LitertEngine:
    """refine: eye centres are those of the irises, at the cost of two small networks. portable: the same eyes to the last bit in
    every version of OpenCV, at the cost of 0.14 ms.

    Raises UserError if mediapipe's network files are missing or have another version.
    """

    name = "litert"

    def __init__(self, refine: bool = False, portable: bool = False) -> None:
        self._warp = portable_warp if portable else warp
        path = model_file("modules/face_landmark/face_landmark.tflite")
        self._network = Network(path, (1, SIZE_PX, SIZE_PX, 3), (POINTS * 3, 1))
        self._near = Detector(warp=self._warp)
        self._far: Detector | None = None  # loaded when it is first needed
        self._irises = Irises(self._warp) if refine else None
        self.model = self._network.name + (f" + {self._irises.model}" if self._irises else "")
        self.rotated_deg = 0
        self._rotated: dict[int, int] = {}  # rotation -> number of faces
        self._size: tuple[int, ...] = ()
        self.reset()

    def reset(self) -> None:
        self._roi: Roi | None = None
        self._followed: Face | None = None
        self._selector = FaceSelector()
        self._without = 0  # pictures since there was a face

    def close(self) -> None:
        self.reset()

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        """See Engine.detect; also takes grey, BGRA and 16-bit pictures. Raises UserError for other arrays."""
        bgr = as_bgr8(image)
        if bgr.shape[:2] != self._size:  # regions in px of another size are invalid
            self._size = bgr.shape[:2]
            self.reset()
        face = self._measure(bgr, self._roi, KEPT) if self._roi else None
        face = face or self._search(bgr)
        self._followed = face
        if face is None:
            self._roi = None
            self._without += 1
        else:
            self._selector.follow(face.box_px)
            self._without = 0
        return face

    def examine(self, image: NDArray[np.uint8]) -> None:
        """See Engine.examine. If another face should be followed, that starts with the next picture."""
        if self._followed is None or not self._selector.due:
            return
        bgr = as_bgr8(image)
        height_px, width_px = bgr.shape[:2]
        rival = self._selector.rival(self._near.detect(bgr), self._followed.box_px, width_px, height_px)
        kept = self._roi
        if rival is None or (face := self._acquire(bgr, _region(rival), FOUND)) is None:
            self._roi = kept
            return
        self._selector.change(face.box_px)

    def _search(self, bgr: NDArray[np.uint8]) -> Face | None:
        """Searches the whole picture for a face."""
        height_px, width_px = bgr.shape[:2]
        looks = [(FOUND, self._near.detect(bgr))]
        if self._without % FAR_EVERY == FAR_EVERY - 1:
            looks.append((FOUND_FAR, self._look_far(bgr)))
        elif self._without % FAR_EVERY == FAR_EVERY // 2:
            self._look_rotated(bgr)
        for least, found in looks:
            for candidate in self._selector.rank(found, width_px, height_px)[:CANDIDATES]:
                if face := self._acquire(bgr, _region(candidate), least):
                    return face
        return None

    def _acquire(self, bgr: NDArray[np.uint8], roi: Roi, least: float) -> Face | None:
        """Measures a new face in roi. A leaning face is measured again until its own region is found. The detector often takes an
        upside-down face for an upright one, but the landmark network is more confident in the rotated region."""
        face = self._measure(bgr, roi, least)
        for _ in range(REPEATS):
            if face is None or abs(face.lean_deg) < LEANING_DEG:
                break
            assert self._roi is not None
            face = self._measure(bgr, self._roi, KEPT)
        if face is None or self._roi is None:
            return None
        kept, counted, sure = self._roi, sum(self._rotated.values()), self._run(bgr, self._roi)[1]
        for angle in QUARTERS:
            turned = attrs.evolve(kept, angle=kept.angle + angle)
            if self._run(bgr, turned)[1] > sure:
                self._measure(bgr, turned, FOUND)
        self._roi = kept
        return None if sum(self._rotated.values()) > counted else face

    def _look_far(self, bgr: NDArray[np.uint8]) -> list[Detection]:
        """Searches small faces, alternately in the whole picture and, enlarged, in one of three parts that cover its width."""
        if self._far is None:
            self._far = Detector(FULL, self._warp)
        height_px, width_px = bgr.shape[:2]
        part = self._without // FAR_EVERY % 4
        if part == 0:
            return self._far.detect(bgr)
        side_px = 0.6 * max(width_px, height_px)
        x_px, y_px = (min(max(share * length, side_px / 2), max(length - side_px / 2, length / 2)) for share, length in
                      (((0.5, 0.0, 1.0)[part - 1], width_px), (0.4, height_px)))  # fmt: skip
        return self._far.detect(bgr, Roi(x_px, y_px, side_px, 0.0))

    def _look_rotated(self, bgr: NDArray[np.uint8]) -> None:
        """Counts faces that are upside down or sideways; the detector misses many of them unless the picture is rotated."""
        height_px, width_px = bgr.shape[:2]
        angle = QUARTERS[self._without // FAR_EVERY % 3]
        whole = Roi(width_px / 2, height_px / 2, max(width_px, height_px), angle)
        for candidate in self._near.detect(bgr, whole)[:1]:
            self._measure(bgr, _region(candidate), FOUND)

    def _run(self, bgr: NDArray[np.uint8], roi: Roi) -> tuple[NDArray[np.float32], float]:
        """Returns the network's points in px of the crop, flat, and the logit of its confidence."""
        crop = roi.crop(bgr, SIZE_PX, cv2.BORDER_REPLICATE, self._warp)
        fill(self._network.input, crop, 0.0, 1.0)
        values, logit = self._network.run()
        return values, float(logit[0])

    def _measure(self, bgr: NDArray[np.uint8], roi: Roi, least: float) -> Face | None:
        """Measures the face in roi; its region is used for the next picture. least: the required confidence."""
        values, logit = self._run(bgr, roi)
        confidence = 1 / (1 + math.exp(-min(max(logit, -80.0), 80.0)))
        if confidence < least:
            return None
        matrix, mesh = roi.matrix(SIZE_PX), values.reshape(POINTS, 3)
        x, y = matrix[:, 2].tolist()
        points = matrix[:, :1] * mesh[:, 0] + matrix[:, 1:2] * mesh[:, 1]  # (2, 468) px from (x, y)
        (x0, y0), (x1, y1) = points.min(axis=1).tolist(), points.max(axis=1).tolist()
        scale = roi.side_px / SIZE_PX
        found = eye_points(points, mesh[:, 2] * np.float32(scale))
        edges = x0 + x, y0 + y, x1 + x, y1 + y
        region = around(edges, found.right_corner, found.left_corner)
        lean_deg = math.degrees(region.angle)
        # narrower than a pixel, or NaN: no region for the next picture
        if not 1.0 <= region.side_px < math.inf or not self._upright(lean_deg):
            return None
        self._roi = region
        head_px = np.column_stack((points.T[_HEAD], mesh[_HEAD, 2] * scale))
        if self._irises is None:
            eyes = np.add((found.left, found.right), (x, y))
            return Face(eyes, confidence, edges, apart_px=found.apart, lean_deg=lean_deg, head_px=head_px)
        mesh_px = points.T + matrix[:, 2]
        irises = self._irises.find(bgr, mesh_px)
        frontal = abs(turn(mesh_px[list(TURN)])) <= FRONTAL
        lids = np.add((found.left, found.right), (x, y))
        off = (irises[:, 0] - lids) / max(found.apart, 1.0)
        seen = float(np.hypot(*(off[0] - off[1]))) <= APART and float(np.abs(off).max()) <= ASIDE
        eyes, iris_px = (irises[:, 0], iris_diameter(irises) if frontal else 0.0) if seen else (lids, 0.0)
        return Face(eyes, confidence, edges, iris_px, found.apart, lean_deg, head_px)

    def _upright(self, lean_deg: float) -> bool:
        """Whether a head can lean this far, clockwise. Counts faces that lean further, because the picture may be rotated."""
        if abs(lean_deg) <= UPRIGHT_DEG:
            return True
        turned = round(-lean_deg / 90) * 90 % 360
        self._rotated[turned] = self._rotated.get(turned, 0) + 1
        if self._rotated[turned] >= ROTATED_FACES:
            self.rotated_deg = turned
        return False


def _region(face: Detection) -> Roi:
    return around(face.box_px, face.points_px[0], face.points_px[1])
