"""Networks of the mediapipe wheel, run in this thread through LiteRT, and the square, rotated crop
of the picture that they see. Faces in a whole picture: the face detectors of MediaPipe (BlazeFace,
arXiv:1907.05047), and the choice of the viewer's face.

mediapipe itself is never imported. Proportions of crops are those of the face graphs for which the
networks were trained (MediaPipe, modules/face_landmark). `FaceSelector` counts pictures, not time:
an engine has no clock, and a replay must make the same decisions as the session.
"""

import ctypes
import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.host.terminal import quiet_stderr
from lfpipe.track import models

# (image (h, w, 4), affine (2, 3) from crop px to image px, size_px, border) -> crop, uint8
# (size_px, size_px, 4)
Warp = Callable[[NDArray[np.uint8], NDArray[np.float64], int, int], NDArray[np.uint8]]

# size of the region relative to the face, so that it also contains the next picture's face
SCALE = 1.5


def model_file(relative: str) -> Path:
    """Path of a file of the mediapipe wheel, for example
    "modules/face_landmark/face_landmark.tflite". Raises UserError if absent.
    """
    if (path := models.find_model(relative)) is not None:
        return path
    where = f"in {models.package_folder() or 'no package mediapipe'} and {models.data_folder()}"
    raise UserError(
        f"track.engine = litert: face network {Path(relative).name} is missing {where}",
        models.REMEDY,
    )


class Network:
    """One .tflite network, single-threaded: one picture, float32 outputs identified by their number
    of values.

    path: the file. size_px: side of the picture. outputs: number of values of each wanted output.
    low: value of black; white is 1. Raises UserError if the file is unreadable, not a network, or a
    network of another shape (another version).
    """

    def __init__(
        self, path: Path, size_px: int, outputs: tuple[int, ...], low: float = 0.0
    ) -> None:
        from ai_edge_litert.interpreter import Interpreter

        try:
            content = path.read_bytes()
            with quiet_stderr():  # the delegate logs
                self._interpreter: Any = Interpreter(model_content=content, num_threads=1)
                self._interpreter.allocate_tensors()
        except (OSError, ValueError, RuntimeError) as error:
            reason = (
                str(error).strip().splitlines()[0] if str(error).strip() else "LiteRT rejects it"
            )
            raise UserError(
                f"track.engine = litert: {path}: not a usable face network: {reason}",
                models.DAMAGED,
            ) from None
        first, *_ = self._interpreter.get_input_details()
        details = self._interpreter.get_output_details()
        by_size = {int(np.prod(detail["shape"])): int(detail["index"]) for detail in details}
        shape = tuple(int(size) for size in first["shape"])
        if shape != (1, size_px, size_px, 3) or any(size not in by_size for size in outputs):
            raise UserError(
                f"track.engine = litert: {path}: has another version: input {shape}, outputs of"
                f" {sorted(by_size)} values; expected {(1, size_px, size_px, 3)} and"
                f" {sorted(outputs)}",
                models.DAMAGED,
            )
        self.invoke: Callable[[], None] = self._interpreter.invoke
        self.invoke()  # the first run is slow: do it before the first frame
        self._input = self._memory(int(first["index"])).reshape(shape[1:])
        self._outputs = [self._memory(by_size[size]) for size in outputs]
        levels = np.arange(256, dtype=np.float32) * np.float32((1.0 - low) / 255)
        self._levels = (levels + np.float32(low) if low else levels).reshape(1, 256)
        sha256 = hashlib.sha256(content).hexdigest()
        version = models.VERSION if sha256 in models.SHA256.values() else "of unknown version"
        self.name = f"{path.name} (mediapipe {version}, sha256 {sha256[:8]})"

    def run(self, crop: NDArray[np.uint8]) -> list[NDArray[np.float32]]:
        """The wanted outputs, flat, for crop, uint8 BGRA (size_px, size_px, 4); valid until the
        next run.
        """
        cv2.LUT(cv2.cvtColor(crop, cv2.COLOR_BGRA2RGB), self._levels, self._input)
        self.invoke()
        return self._outputs

    def _memory(self, index: int) -> NDArray[np.float32]:
        """A flat view of a tensor's memory. Its address does not change: nothing is allocated after
        the first run. (LiteRT's own views must be dropped before each run, so they cannot be
        stored.)
        """
        tensor = self._interpreter.tensor(index)()
        return np.frombuffer(
            (ctypes.c_float * tensor.size).from_address(tensor.ctypes.data), np.float32
        )


def warp(
    image: NDArray[np.uint8], matrix: NDArray[np.float64], size_px: int, border: int
) -> NDArray[np.uint8]:
    """OpenCV's warp: OpenCV 5 interpolates exactly, OpenCV 4 at positions rounded to 1/32 px."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(image, matrix, (size_px, size_px), flags=flags, borderMode=border), np.uint8
    )


def portable_warp(
    image: NDArray[np.uint8], matrix: NDArray[np.float64], size_px: int, border: int
) -> NDArray[np.uint8]:
    """A warp at positions rounded to 1/32 px, bit-identical in every OpenCV from 4.10 on; 0.14 ms
    slower than `warp` for 192x192.
    """
    steps = np.arange(size_px)
    along_px = matrix[:, 0, None] * steps
    down_px = matrix[:, 1, None] * steps + matrix[:, 2, None]
    along, down = (np.rint(1024 * place_px).astype(np.int32) for place_px in (along_px, down_px))
    place = along[:, None, :] + (down + 16)[:, :, None]  # (x and y, row, column), in 1/1024 px
    x, y = place.astype(np.uint16)
    rest = (y & 992) | ((x >> 5) & 31)  # 1/32 px down and along, five bits each
    whole = np.empty((size_px, size_px, 2), np.int16)
    whole[..., 0], whole[..., 1] = place >> 10
    return np.asarray(cv2.remap(image, whole, rest, cv2.INTER_LINEAR, borderMode=border), np.uint8)


@attrs.frozen
class Roi:
    """A square in picture px."""

    x_px: float
    """Of the centre."""
    y_px: float
    """Of the centre."""
    side_px: float
    angle: float
    """Of its x axis, radians, clockwise (y points down)."""

    def matrix(self, size_px: int) -> NDArray[np.float64]:
        """Affine (2, 3) from crop px (0..size_px) to picture px."""
        scale = self.side_px / size_px
        c, s = math.cos(self.angle) * scale, math.sin(self.angle) * scale
        half = size_px / 2
        return np.array([[c, -s, self.x_px - half * (c - s)], [s, c, self.y_px - half * (s + c)]])

    def crop(
        self,
        image: NDArray[np.uint8],
        matrix: NDArray[np.float64],
        size_px: int,
        border: int,
        warp: Warp = warp,
    ) -> NDArray[np.uint8]:
        """The region as uint8 BGRA (size_px, size_px, 4). matrix: of `matrix(size_px)`. border:
        cv2.BORDER_*, how to fill pixels outside of the picture.

        Warping four channels takes 0.4 of the time of three, with the same values.
        """
        # half of the rotated square's extent, plus the margin for interpolation
        reach = 0.5 * self.side_px * (abs(math.cos(self.angle)) + abs(math.sin(self.angle))) + 2
        height, width = image.shape[:2]
        x0 = min(max(int(self.x_px - reach), 0), width)
        x1 = min(max(int(self.x_px + reach), 0), width)
        y0 = min(max(int(self.y_px - reach), 0), height)
        y1 = min(max(int(self.y_px + reach), 0), height)
        if x1 - x0 < 1 or y1 - y0 < 1:
            x0, y0, x1, y1 = 0, 0, width, height
        moved = matrix.copy()
        moved[0, 2] -= x0
        moved[1, 2] -= y0
        part = cv2.cvtColor(image[y0:y1, x0:x1], cv2.COLOR_BGR2BGRA)
        return warp(part, moved, size_px, border)  # type: ignore[arg-type]


def mapped(points: NDArray[np.floating], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """points (n, 2) in crop px -> picture px."""
    return np.asarray(
        cv2.transform(np.asarray(points, np.float64)[:, None], matrix)[:, 0], np.float64
    )


def around(
    box_px: tuple[float, float, float, float],
    start: Sequence[float],
    end: Sequence[float],
    scale: float = SCALE,
) -> Roi:
    """Region around an upright box (x0, y0, x1, y1), turned so that start -> end (eye to eye) lies
    along its x axis.
    """
    x0, y0, x1, y1 = box_px
    angle = math.atan2(float(end[1] - start[1]), float(end[0] - start[0]))
    return Roi((x0 + x1) / 2, (y0 + y1) / 2, max(x1 - x0, y1 - y0) * scale, angle)


MIN_OVERLAP = 0.3  # boxes that overlap more belong to one face
# Overlap of one face's boxes in successive pictures: 0.3 at 2 m/s, arm's length and 30 Hz.
SAME_OVERLAP = 0.2
# Overlap with the viewer's usual place: sides differ by less than a third, which excludes people
# behind the viewer.
HOME_OVERLAP = 0.45
SCAN_PERIOD = 30  # pictures between two scans of the whole picture: about a second
FAST_SCAN_PERIOD = 10  # the same while another face may be the viewer, or this one none
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
