"""Faces in a whole picture: the face detectors of MediaPipe (BlazeFace, arXiv:1907.05047), with anchors and suppression."""

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.network import Network, model_file
from lfpipe.track.roi import Roi, Warp, fill, warp

MIN_OVERLAP = 0.3  # boxes that overlap more are one face


@attrs.frozen
class Range:
    """A detection network. size_px: side of its input. grids: (cells per side, anchors per cell). Scores below min_score are
    dropped."""

    file: str
    size_px: int
    grids: tuple[tuple[int, int], ...]
    min_score: float


# short: a viewer at a desk, 1.1 ms. full: faces down to 1/40 of the picture's width (3 m from an ordinary webcam), 11 ms.
SHORT = Range("modules/face_detection/face_detection_short_range.tflite", 128, ((16, 2), (8, 6)), 0.5)
FULL = Range("modules/face_detection/face_detection_full_range_sparse.tflite", 192, ((48, 1),), 0.3)


@attrs.frozen(eq=False)
class Detection:
    """box_px (x0, y0, x1, y1); points_px (6, 2): the person's right and left eye, nose, mouth, right and left ear; score 0..1."""

    box_px: tuple[float, float, float, float]
    points_px: NDArray[np.float64]
    score: float


def anchors(grids: tuple[tuple[int, int], ...]) -> NDArray[np.float32]:
    """Centres (n, 2) of the anchors as (x, y) in 0..1: all anchors have the size of the whole input, so only centres matter."""
    out = []
    for cells, repeats in grids:
        centres = (np.arange(cells, dtype=np.float32) + np.float32(0.5)) / np.float32(cells)
        y, x = np.meshgrid(centres, centres, indexing="ij")
        out.append(np.repeat(np.stack([x.ravel(), y.ravel()], axis=1), repeats, axis=0))
    return np.concatenate(out)


def overlap(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.floating]:
    """Intersection over union of box a (4,) with each of b (n, 4), as (x0, y0, x1, y1); 0 if the union is empty."""
    low, high = np.maximum(a[:2], b[:, :2]), np.minimum(a[2:], b[:, 2:])
    common = np.prod(np.clip(high - low, 0, None), axis=1)
    union = np.prod(a[2:] - a[:2]) + np.prod(b[:, 2:] - b[:, :2], axis=1) - common
    shares: NDArray[np.floating] = np.divide(common, union, out=np.zeros_like(common), where=union > 0)
    return shares


def suppressed(rows: NDArray[np.floating], scores: NDArray[np.floating]) -> list[tuple[NDArray[np.float64], float]]:
    """One (row, score) for each cluster of overlapping boxes, best first: the mean of its rows, weighted by their scores.

    rows (n, 4 + anything): the box (x0, y0, x1, y1), then values to average with it.
    """
    left = list(np.argsort(-scores, kind="stable"))
    out = []
    while left:
        best = left[0]
        together = overlap(rows[best, :4], rows[left, :4]) > MIN_OVERLAP
        together[0] = True  # a box of no area overlaps nothing, itself included
        cluster = [index for index, same in zip(left, together, strict=True) if same]
        left = [index for index, same in zip(left, together, strict=True) if not same]
        weights = scores[cluster].astype(np.float64)
        out.append((weights @ rows[cluster] / weights.sum(), float(scores[best])))
    return out


class Detector:
    """Finds faces at one range. Raises UserError if the network is missing or wrong."""

    def __init__(self, range_: Range = SHORT, warp: Warp = warp) -> None:
        self._range, self._warp = range_, warp
        self._anchors = anchors(range_.grids)
        count, size_px = len(self._anchors), range_.size_px
        self._network = Network(model_file(range_.file), (1, size_px, size_px, 3), (count * 16, count))
        self.model = self._network.name

    def detect(self, image: NDArray[np.uint8], region: Roi | None = None) -> list[Detection]:
        """Faces in uint8 (height, width, 3) BGR, highest score first. region: the part to search; None: the whole picture."""
        height_px, width_px = image.shape[:2]
        size_px = self._range.size_px
        whole = region or Roi(width_px / 2, height_px / 2, max(width_px, height_px), 0.0)
        crop = whole.crop(image, size_px, cv2.BORDER_CONSTANT, self._warp)
        fill(self._network.input, crop, -1.0, 1.0)
        regressors, logits = self._network.run()
        scores = 1 / (1 + np.exp(-np.clip(logits, -80, 80)))  # float32 holds exp(88)
        keep = np.flatnonzero(scores >= self._range.min_score)
        if not len(keep):
            return []
        # each row: centre and size of the box, then six points, all in px of the input and relative to the anchor
        raw = regressors.reshape(-1, 8, 2)[keep] / np.float32(size_px)
        raw[:, [0, 2, 3, 4, 5, 6, 7]] += self._anchors[keep, None]
        centre, half = raw[:, 0], raw[:, 1] / 2
        rows = np.concatenate([centre - half, centre + half, raw[:, 2:].reshape(-1, 12)], axis=1)
        found = []
        for row, score in suppressed(rows, scores[keep]):
            points = whole.to_picture(row.reshape(8, 2) * size_px, size_px)
            (x0, y0), (x1, y1) = points[0], points[1]
            found.append(Detection((float(x0), float(y0), float(x1), float(y1)), points[2:], score))
        return found
