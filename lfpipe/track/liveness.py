"""Liveness detection: rejects photographs and portraits while a living face is in the picture.

Counts pictures, as `FaceSelector` does. Lengths are in eye distances. In 16 clips of living people,
the eyes exceed MIN_MOTION within the first 8 pictures, and within 51 pictures later on; the
landmarks of a photograph move by a tenth as much.
"""

import math

from lfpipe.track.detector import SAME_OVERLAP, Box, Detection, overlap
from lfpipe.track.engine import Face

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
        before = self._others
        self._others = []
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
