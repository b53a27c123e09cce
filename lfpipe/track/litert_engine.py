"""Engine "litert": MediaPipe's landmark network run in this thread, on a region of interest that
follows the face.

The same network and regions as the FaceMesh graph, without its scheduler. A detector runs for the
first face, after a loss, and about once a second in addition. FaceMesh takes the face with the
highest score; this engine takes the viewer's (`FaceSelector`). If the landmark network rejects a
candidate, it tries the next.

`Liveness` rejects photographs and portraits while a living face is in the picture. It counts
pictures, as `FaceSelector` does. Lengths are in eye distances. In 16 clips of living people,
the eyes exceed MIN_MOTION within the first 8 pictures, and within 51 pictures later on; the
landmarks of a photograph move by a tenth as much.
"""

import logging
import math
from collections import Counter

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.engine import Face, FaceNetworks, LitertNetworks
from lfpipe.track.network import (
    FAST_SCAN_PERIOD,
    SAME_OVERLAP,
    Box,
    Detection,
    FaceSelector,
    Roi,
    around,
    overlap,
    prominence,
)

MIN_MOTION = 0.0075  # of low-passed eyes, from their last reference position
SMOOTHING_PICTURES = 8  # pictures; twice as many after a face was found do not count
# Pictures without motion after which a face is a portrait: one that never moved, and one that did.
PORTRAIT_PICTURES, STILL_PICTURES = 60, 300
PORTRAIT_OVERLAP = 0.7  # overlap of a portrait's boxes in two pictures: it does not move
# Motion between scans of a face that is not followed: each scan measures it anew, with more noise.
MIN_SCAN_MOTION = 0.03

Middle = tuple[float, float]


class Liveness:
    """Measures the motion of the followed face and, from scan to scan, of the others."""

    def __init__(self) -> None:
        self._portraits: list[Box] = []
        self.begin()

    def begin(self) -> None:
        """Starts to follow another face."""
        self._smooth: Middle | None = None
        self._anchor: Middle = (0.0, 0.0)
        self._pictures = self._resting = 0
        self._has_moved = False
        self._others: list[tuple[Box, Middle]] = []

    @property
    def still(self) -> bool:
        """Whether the followed face is a portrait."""
        return self._resting >= (STILL_PICTURES if self._has_moved else PORTRAIT_PICTURES)

    def follow(self, face: Face) -> None:
        """Adds a picture of the followed face."""
        here = _middle(face)
        x, y = self._smooth or here
        self._smooth = smooth = (
            x + (here[0] - x) / SMOOTHING_PICTURES,
            y + (here[1] - y) / SMOOTHING_PICTURES,
        )
        self._pictures += 1
        settling = self._pictures <= 2 * SMOOTHING_PICTURES
        if settling or math.dist(smooth, self._anchor) > MIN_MOTION * max(
            face.eye_distance_px, 1.0
        ):
            self._has_moved |= not settling
            self._anchor = smooth
            self._resting = 0
        else:
            self._resting += 1

    def scanned(self, followed: Box) -> None:
        """Remembers the box in which a scan found the followed face, if it is a portrait, else
        forgets the portraits there.
        """
        self._portraits = [
            box for box in self._portraits if overlap(box, followed) <= PORTRAIT_OVERLAP
        ]
        if self.still:
            self._portraits.append(followed)

    def is_portrait(self, candidate: Detection) -> bool:
        return any(overlap(box, candidate.box_px) > PORTRAIT_OVERLAP for box in self._portraits)

    def others_alive(self, others: list[Face]) -> list[Face]:
        """The other faces of a scan that have moved since they were first seen here."""
        before, self._others = self._others, []
        alive = []
        for face in others:
            here = _middle(face)
            first = next(
                (at for box, at in before if overlap(box, face.box_px) > SAME_OVERLAP), here
            )
            self._others.append((face.box_px, first))
            if math.dist(first, here) > MIN_SCAN_MOTION * face.eye_distance_px:
                alive.append(face)
        return alive


def _middle(face: Face) -> Middle:
    (lx, ly), (rx, ry) = face.eyes_px.tolist()
    return (lx + rx) / 2, (ly + ry) / 2


NEW_CONFIDENCE = 0.5  # minimum for a new face
# Minimum for a small new face: its detector has many false alarms, and real faces score higher.
NEW_FAR_CONFIDENCE = 0.9
# Minimum for a followed face: a hand in front of it lowers confidence more than accuracy.
FOLLOWED_CONFIDENCE = 0.2
# The same behind a mask and anaglyph glasses (-5.3 logits in one of 20), if the detector confirms
# the face: it scores 19 of 20 such faces at 0.7, and the likeliest scene without a face at 0.6.
DOUBTFUL_CONFIDENCE, CERTAIN_SCORE = 0.005, 0.7
MAX_CANDIDATES = 6  # faces per picture that the landmark network tries, 1.3 ms each
# Eye distance over the picture's longer side (1.5 m away): the near detector misses such faces.
SMALL_EYE_DISTANCE = 0.04
FAR_PERIOD = 8  # pictures without a face between runs of the full-range detector (10 ms each)
MAX_LEAN_DEG = 80.0  # no head leans further; such a face is in a rotated picture
# A new face that leans further is measured again, at most MAX_REMEASUREMENTS times.
REMEASURE_DEG, MAX_REMEASUREMENTS = 30.0, 4
# Wrong orientations of a camera or a picture.
QUARTER_TURNS = (math.pi, math.pi / 2, -math.pi / 2)
# Logits that a face gains in a region rotated by quarter turns: upside down 11 to 32, behind a mask
# up to 4.3.
ROTATED_LOGITS = 5.0
HINT_FACES = 3  # rotated faces before the hint appears

log = logging.getLogger(__name__)


class LitertEngine:
    """Finds and follows the viewer's face with the networks given; by default `LitertNetworks`."""

    name = "litert"

    def __init__(self, networks: FaceNetworks | None = None) -> None:
        self._networks = networks or LitertNetworks()
        self.model = self._networks.model
        self.rotated_deg = 0
        self._rotated: Counter[int] = Counter()  # rotation in degrees
        self._size: tuple[int, ...] = ()
        self._liveness = Liveness()
        self.reset()

    def reset(self) -> None:
        """See Engine.reset. Known portraits stay known."""
        self._liveness.begin()
        self._doubts = 0
        self._roi: Roi | None = None
        self._followed: Face | None = None
        self._selector = FaceSelector()
        self._scan = False
        self._without = 0  # pictures since there was a face

    def close(self) -> None:
        self.reset()

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        if image.shape[:2] != self._size:  # regions in px of another size are invalid
            self._size = image.shape[:2]
            self._liveness = Liveness()
            self.reset()
        measured = (
            self._networks.measure(image, self._roi, DOUBTFUL_CONFIDENCE) if self._roi else None
        )
        if measured is None or not self._keeps(image, measured[0]):
            measured = self._search(image)
            self._liveness.begin()
        if measured is None:
            self._followed = self._roi = None
            self._without += 1
            return None
        self._followed, self._roi = measured
        self._liveness.follow(self._followed)
        self._scan = self._selector.follow(self._followed.box_px, self._liveness.still)
        self._without = 0
        return self._followed

    def _keeps(self, image: NDArray[np.uint8], face: Face) -> bool:
        """Whether to keep following a face: it must be upright and, if the landmark network is
        unsure, confirmed by the detector now and then.
        """
        if abs(face.lean_deg) > MAX_LEAN_DEG:
            return False
        if face.confidence >= FOLLOWED_CONFIDENCE:
            self._doubts = 0
            return True
        self._doubts += 1
        if self._doubts % FAST_SCAN_PERIOD != 1:
            return True
        return any(
            one.score >= CERTAIN_SCORE and overlap(one.box_px, face.box_px) > SAME_OVERLAP
            for one in self._networks.detect(image)
        )

    def examine(self, image: NDArray[np.uint8]) -> None:
        """See Engine.examine.

        If another face should be followed, that starts with the next picture.
        """
        if self._followed is None or not self._scan:
            return
        followed = self._followed
        self._scan = False
        height_px, width_px = image.shape[:2]
        candidates = self._networks.detect(image)
        if followed.eye_distance_px < SMALL_EYE_DISTANCE * max(width_px, height_px):
            candidates += self._networks.detect_far(image)
        own = [one for one in candidates if overlap(followed.box_px, one.box_px) > SAME_OVERLAP]
        if own:
            box = max(own, key=lambda one: overlap(followed.box_px, one.box_px)).box_px
            self._liveness.scanned(box)
        candidates = [
            one for one in candidates if one in own or not self._liveness.is_portrait(one)
        ]
        measured = self._living(image, candidates, followed) if self._liveness.still else None
        if measured is None:
            rival = self._selector.rival(candidates, followed.box_px, width_px, height_px)
            measured = self._acquire(image, rival, NEW_CONFIDENCE) if rival else None
        if measured is not None:
            face, self._roi = measured
            log.info("now following another face: %s instead of %s", face.box_px, followed.box_px)
            self._selector.change(face.box_px)
            self._liveness.begin()

    def _living(
        self, image: NDArray[np.uint8], candidates: list[Detection], followed: Face
    ) -> tuple[Face, Roi] | None:
        """The most prominent living face, to follow instead of a portrait."""
        others = [one for one in candidates if overlap(followed.box_px, one.box_px) <= SAME_OVERLAP]
        measured = [self._acquire(image, one, NEW_CONFIDENCE) for one in others[:MAX_CANDIDATES]]
        regions = {id(one[0]): one for one in measured if one is not None}
        alive = self._liveness.others_alive([one for one, _ in regions.values()])
        size_px = image.shape[1], image.shape[0]
        best = max(alive, key=lambda face: prominence(face.box_px, *size_px), default=None)
        return None if best is None else regions[id(best)]

    def _search(self, image: NDArray[np.uint8]) -> tuple[Face, Roi] | None:
        """Searches the whole picture for a face."""
        height_px, width_px = image.shape[:2]
        near = self._networks.detect(image)
        looks = [(NEW_CONFIDENCE, near)]
        if self._without % FAR_PERIOD == FAR_PERIOD - 1:
            looks.append((NEW_FAR_CONFIDENCE, self._look_far(image)))
        elif self._without % FAR_PERIOD == FAR_PERIOD // 2:
            self._look_rotated(image)
        looks.append((DOUBTFUL_CONFIDENCE, [one for one in near if one.score >= CERTAIN_SCORE]))
        for min_confidence, candidates in looks:
            ranked = self._selector.rank(candidates, width_px, height_px)
            ranked.sort(key=self._liveness.is_portrait)  # a portrait is better than no face
            for candidate in ranked[:MAX_CANDIDATES]:
                if (measured := self._acquire(image, candidate, min_confidence)) is not None:
                    return measured
        return None

    def _acquire(
        self, image: NDArray[np.uint8], candidate: Detection, min_confidence: float
    ) -> tuple[Face, Roi] | None:
        """Measures a new face and its own region; None if it is not upright, which counts for the
        hint.

        A leaning face is measured again until its own region is found; a face that the picture's
        border cuts off, once: there, the detector's region is off by up to a third of the eye
        distance. The detector often takes an upside-down face for an upright one, but the landmark
        network is more confident in the rotated region.
        """
        measured = self._networks.measure(
            image, around(candidate.box_px, *candidate.points_px[:2]), min_confidence
        )
        for k in range(MAX_REMEASUREMENTS):
            if measured is None:
                break
            face = measured[0]
            x0, y0, x1, y1 = face.box_px
            cut_off = min(x0, y0) < 0 or x1 > image.shape[1] or y1 > image.shape[0]
            if not (k == 0 and cut_off) and abs(face.lean_deg) < REMEASURE_DEG:
                break
            measured = self._networks.measure(
                image, measured[1], min(FOLLOWED_CONFIDENCE, min_confidence)
            )
        if measured is None or self._is_rotated(measured[0]):
            return None
        region = measured[1]
        turned = [attrs.evolve(region, angle=region.angle + angle) for angle in QUARTER_TURNS]
        sure, *logits = (self._networks.logit(image, roi) for roi in (region, *turned))
        surest = max(range(len(QUARTER_TURNS)), key=logits.__getitem__)
        rotated = (
            self._networks.measure(image, turned[surest], NEW_CONFIDENCE)
            if logits[surest] > sure + ROTATED_LOGITS
            else None
        )
        if rotated is None:
            return measured
        return None if self._is_rotated(rotated[0]) else rotated

    def _is_rotated(self, face: Face) -> bool:
        """Whether a face leans further than a head can: the picture is rotated. The most frequent
        rotation is the hint.
        """
        if abs(face.lean_deg) <= MAX_LEAN_DEG:
            return False
        self._rotated[round(-face.lean_deg / 90) * 90 % 360] += 1
        if not self.rotated_deg and self._rotated.total() >= HINT_FACES:
            ((self.rotated_deg, _),) = self._rotated.most_common(1)
            log.info("faces are rotated: %s", dict(self._rotated))
        return True

    def _look_far(self, image: NDArray[np.uint8]) -> list[Detection]:
        """Searches for small faces, alternately in the whole picture and, enlarged, in one of three
        parts that cover its width.
        """
        height_px, width_px = image.shape[:2]
        turn = self._without // FAR_PERIOD % 4
        if turn == 0:
            return self._networks.detect_far(image)
        side_px = 0.6 * max(width_px, height_px)
        x_px, y_px = (
            min(max(share * length, side_px / 2), max(length - side_px / 2, length / 2))
            for share, length in (((0.5, 0.0, 1.0)[turn - 1], width_px), (0.4, height_px))
        )
        return self._networks.detect_far(image, Roi(x_px, y_px, side_px, 0.0))

    def _look_rotated(self, image: NDArray[np.uint8]) -> None:
        """Counts faces that are upside down or sideways; the detector misses many of them unless
        the picture is rotated.
        """
        height_px, width_px = image.shape[:2]
        angle = QUARTER_TURNS[self._without // FAR_PERIOD % 3]
        whole = Roi(width_px / 2, height_px / 2, max(width_px, height_px), angle)
        for candidate in self._networks.detect(image, whole)[:1]:
            roi = around(candidate.box_px, *candidate.points_px[:2])
            if (measured := self._networks.measure(image, roi, NEW_CONFIDENCE)) is not None:
                self._is_rotated(measured[0])
