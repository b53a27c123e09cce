"""Networks of the mediapipe wheel, run in this thread through LiteRT, and the square, rotated crop
of the picture that they see.

mediapipe itself is never imported. Proportions of crops are those of the face graphs for which the
networks were trained (MediaPipe, modules/face_landmark).
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
            x0 = 0
            y0 = 0
            x1 = width
            y1 = height
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
