"""Faces in a whole picture: the face detectors of MediaPipe (BlazeFace, arXiv:1907.05047), and the
choice of the viewer's face.

`FaceSelector` counts pictures, not time: an engine has no clock, and a replay must make the same
decisions as the session.
"""

import math
from collections.abc import Sequence

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.network import Network, Roi, Warp, mapped, model_file, warp

MIN_OVERLAP = 0.3  # boxes that overlap more belong to one face
# Overlap of one face's boxes in successive pictures: 0.3 at 2 m/s, arm's length and 30 Hz.
SAME_OVERLAP = 0.2
# Overlap with the viewer's usual place: sides differ by less than a third, which excludes people
# behind the viewer.
HOME_OVERLAP = 0.45
SCAN_PERIOD = 30  # pictures between two scans of the whole picture: about a second
FAST_SCAN_PERIOD = 10  # the same while another face may be the viewer
NEARER_SCANS = 4  # consecutive fast scans that a nearer face must win: about a second
MIN_NEARER_RATIO = 1.6  # of prominence; equal faces never alternate
HOME_GAIN = 0.02  # low-pass gain of the viewer's usual place: 50 pictures
HOME_PICTURES = 150  # after so many pictures at another place, that place becomes the usual one

Box = tuple[float, float, float, float]


@attrs.frozen
class Range:
    """A detection network."""

    file: str
    size_px: int
    """Side of its input."""
    grids: tuple[tuple[int, int], ...]
    """(cells per side, anchors per cell)."""
    min_score: float
    """Faces with lower scores are dropped."""


# short: a viewer at a desk, 1.1 ms. full: faces down to 1/40 of the picture's width (3 m from an
# ordinary webcam), 11 ms.
SHORT = Range(
    "modules/face_detection/face_detection_short_range.tflite", 128, ((16, 2), (8, 6)), 0.5
)
FULL = Range("modules/face_detection/face_detection_full_range_sparse.tflite", 192, ((48, 1),), 0.3)


@attrs.frozen(eq=False)
class Detection:
    """A face that a detector found."""

    box_px: tuple[float, float, float, float]
    """(x0, y0, x1, y1)."""
    points_px: NDArray[np.float64]
    """(6, 2): the person's right and left eye, nose, mouth, right and left ear."""
    score: float
    """0 to 1."""


def anchors(grids: tuple[tuple[int, int], ...]) -> NDArray[np.float32]:
    """Centres (n, 2) of the anchors as (x, y) in 0..1: all anchors have the size of the whole
    input, so only centres matter.
    """
    out = []
    for cells, repeats in grids:
        centres = (np.arange(cells, dtype=np.float32) + np.float32(0.5)) / np.float32(cells)
        y, x = np.meshgrid(centres, centres, indexing="ij")
        out.append(np.repeat(np.stack([x.ravel(), y.ravel()], axis=1), repeats, axis=0))
    return np.concatenate(out)


def overlap(a: Box, b: Box) -> float:
    """Intersection over union of two boxes (x0, y0, x1, y1)."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    common = max(width, 0.0) * max(height, 0.0)
    union = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common
    return common / union if union > 0 else 0.0


def suppressed(
    rows: NDArray[np.floating], scores: NDArray[np.floating]
) -> list[tuple[NDArray[np.float64], float]]:
    """One (row, score) for each cluster of overlapping boxes, best first: the mean of its rows,
    weighted by their scores.

    rows (n, 4 + anything): the box (x0, y0, x1, y1), then values to average with it.
    """
    left = list(np.argsort(-scores, kind="stable"))
    boxes: list[Box] = rows[:, :4].tolist()
    out = []
    while left:
        best = left[0]  # a box of no area overlaps nothing, itself included
        cluster = [
            index
            for index in left
            if index == best or overlap(boxes[best], boxes[index]) > MIN_OVERLAP
        ]
        left = [index for index in left if index not in cluster]
        weights = scores[cluster].astype(np.float64)
        out.append((weights @ rows[cluster] / weights.sum(), float(scores[best])))
    return out


class Detector:
    """Finds faces at one range. Raises UserError if the network is missing or wrong."""

    def __init__(self, range_: Range = SHORT, warp: Warp = warp) -> None:
        self._range = range_
        self._warp = warp
        self._anchors = anchors(range_.grids)
        count = len(self._anchors)
        self._network = Network(
            model_file(range_.file), range_.size_px, (count * 16, count), low=-1.0
        )

    def detect(self, image: NDArray[np.uint8], region: Roi | None = None) -> list[Detection]:
        """Faces in uint8 (height, width, 3) BGR, highest score first.

        region: the part to search; None: the whole picture.
        """
        height_px, width_px = image.shape[:2]
        size_px = self._range.size_px
        whole = region or Roi(width_px / 2, height_px / 2, max(width_px, height_px), 0.0)
        matrix = whole.matrix(size_px)
        regressors, logits = self._network.run(
            whole.crop(image, matrix, size_px, cv2.BORDER_CONSTANT, self._warp)
        )
        scores = 1 / (1 + np.exp(-np.clip(logits, -80, 80)))  # float32 holds exp(88)
        keep = np.flatnonzero(scores >= self._range.min_score)
        if not len(keep):
            return []
        # each row: centre and size of the box, then six points, all in px of the input and relative
        # to the anchor
        raw = regressors.reshape(-1, 8, 2)[keep] / np.float32(size_px)
        raw[:, [0, 2, 3, 4, 5, 6, 7]] += self._anchors[keep, None]
        centre = raw[:, 0]
        half = raw[:, 1] / 2
        rows = np.concatenate([centre - half, centre + half, raw[:, 2:].reshape(-1, 12)], axis=1)
        faces = []
        for row, score in suppressed(rows, scores[keep]):
            points = mapped(row.reshape(8, 2) * size_px, matrix)
            (x0, y0), (x1, y1) = points[:2].tolist()
            faces.append(Detection((x0, y0, x1, y1), points[2:], score))
        return faces


def prominence(box: Box, width_px: int, height_px: int) -> float:
    """Likelihood that a face is the viewer's: its area, divided by 1 + (distance from the centre /
    half diagonal)^2.
    """
    x0, y0, x1, y1 = box
    away = math.hypot(
        (x0 + x1 - width_px) / width_px, (y0 + y1 - height_px) / height_px
    ) / math.sqrt(2)
    return (x1 - x0) * (y1 - y0) / (1 + away * away)


class FaceSelector:
    """Remembers where the viewer usually is. Ranks the faces of a picture, and decides whether to
    follow another one.

    If another face is followed, a face at the usual place is the viewer, who was hidden by a
    passer-by; the selector returns to it at once. A face that is clearly nearer and more central
    (MIN_NEARER_RATIO) for NEARER_SCANS scans takes over.
    """

    def __init__(self) -> None:
        self._home: Box | None = None
        self._away = 0  # pictures since the face followed left the usual place
        self._pictures = 0  # since the last scan
        self._rival: Box | None = None
        self._wins = 0

    def follow(self, box: Box, doubted: bool = False) -> bool:
        """Adds the box of the followed face in this picture. doubted: it may not be a viewer.

        Returns whether to scan the whole picture for other faces now.
        """
        self._pictures += 1
        if self._home is None or self._away > HOME_PICTURES:
            self._home = box
            self._away = 0
        elif overlap(self._home, box) > HOME_OVERLAP:
            x0, y0, x1, y1 = self._home
            a, b, c, d = box
            share = HOME_GAIN
            self._home = (
                x0 + share * (a - x0),
                y0 + share * (b - y0),
                x1 + share * (c - x1),
                y1 + share * (d - y1),
            )
            self._away = 0
        else:
            self._away += 1
        soon = self._away or self._wins or doubted
        return self._pictures >= (FAST_SCAN_PERIOD if soon else SCAN_PERIOD)

    def rank(self, faces: Sequence[Detection], width_px: int, height_px: int) -> list[Detection]:
        """Faces of a picture in which none is followed, best first: at the usual place, then by
        prominence.
        """

        def order(face: Detection) -> tuple[bool, float]:
            return self._at_home(face.box_px), prominence(face.box_px, width_px, height_px)

        return sorted(faces, key=order, reverse=True)

    def rival(
        self, faces: Sequence[Detection], followed: Box, width_px: int, height_px: int
    ) -> Detection | None:
        """The face to follow instead of the one in the box followed; None: no change, or
        not yet.
        """
        self._pictures = 0
        others = [face for face in faces if overlap(followed, face.box_px) <= SAME_OVERLAP]
        back = [face for face in others if self._at_home(face.box_px)]
        if self._away and back:
            return max(back, key=lambda face: face.score)
        nearest = max(
            (face.box_px for face in faces),
            key=lambda box: overlap(followed, box),
            default=followed,
        )
        own = nearest if overlap(followed, nearest) > SAME_OVERLAP else followed
        least = MIN_NEARER_RATIO * prominence(own, width_px, height_px)
        best = max(
            others, key=lambda face: prominence(face.box_px, width_px, height_px), default=None
        )
        if best is None or prominence(best.box_px, width_px, height_px) < least:
            self._wins = 0
            return None
        again = (
            self._wins > 0
            and self._rival is not None
            and overlap(self._rival, best.box_px) > SAME_OVERLAP
        )
        self._rival = best.box_px
        self._wins = self._wins + 1 if again else 1
        return best if self._wins >= NEARER_SCANS else None

    def change(self, box: Box) -> None:
        """Starts to follow the face in box; its place becomes the usual one."""
        self._home = box
        self._away = 0
        self._wins = 0
        self._rival = None

    def _at_home(self, box: Box) -> bool:
        return self._home is not None and overlap(self._home, box) > HOME_OVERLAP
