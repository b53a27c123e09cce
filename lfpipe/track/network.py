"""Networks of the mediapipe wheel, run in this thread through LiteRT, and the square, rotated crop of the picture that they see.

mediapipe itself is never imported. Proportions of crops are those of the face graphs for which the networks were trained
(MediaPipe, modules/face_landmark).
"""

import ctypes
import hashlib
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.host.terminal import quiet_stderr
from lfpipe.track import models

# (image (h, w, 4), affine (2, 3) from crop px to image px, size_px, border) -> crop, uint8 (size_px, size_px, 4)
Warp = Callable[[NDArray[np.uint8], NDArray[np.float64], int, int], NDArray[np.uint8]]

SCALE = 1.5  # size of the region relative to the face, so that it also contains the next picture's face


def model_file(relative: str) -> Path:
    """Path of a file of the mediapipe wheel, for example "modules/face_landmark/face_landmark.tflite". Raises UserError if
    absent."""
    path = models.find_model(relative)
    if path is None:
        folder = models.package_folder()
        where = f"not in {folder}" if folder else "mediapipe is not installed"
        where += f", and not in {models.data_folder()}"
        raise UserError(f"track.engine = litert: face network {Path(relative).name} is missing: {where}", models.REMEDY)
    return path


class Network:
    """One .tflite network, single-threaded: one float32 input, float32 outputs identified by their number of values.

    path: the file. input_shape: the required shape. outputs: number of values of each wanted output. input: the network's own
    memory, float32 of input_shape; fill it before each run.
    Raises UserError if the file is unreadable, not a network, or a network of another shape (another version).
    """

    def __init__(self, path: Path, input_shape: tuple[int, ...], outputs: tuple[int, ...]) -> None:
        from ai_edge_litert.interpreter import Interpreter

        try:
            content = path.read_bytes()
            with quiet_stderr():  # the delegate logs
                self._interpreter: Any = Interpreter(model_content=content, num_threads=1)
                self._interpreter.allocate_tensors()
        except (OSError, ValueError, RuntimeError) as error:
            reason = str(error).strip().splitlines()[0] if str(error).strip() else "LiteRT refuses it"
            raise UserError(f"track.engine = litert: {path}: not a usable face network: {reason}", models.remedy(path)) from None
        inputs, details = self._interpreter.get_input_details(), self._interpreter.get_output_details()
        by_size = {int(np.prod(detail["shape"])): int(detail["index"]) for detail in details}
        taken = tuple(int(size) for size in inputs[0]["shape"])
        if taken != input_shape or any(size not in by_size for size in outputs):
            raise UserError(
                f"track.engine = litert: {path}: another version: input {taken}, outputs of {sorted(by_size)} values,"
                f" expected {input_shape} and {sorted(outputs)}",
                models.remedy(path),
            )
        self._interpreter.invoke()  # the first run is slow: do it before the first frame
        self.input = self._memory(int(inputs[0]["index"])).reshape(input_shape)
        self._outputs = [self._memory(by_size[size]) for size in outputs]
        sha256 = hashlib.sha256(content).hexdigest()
        self.name = f"{path.name} ({_version(sha256)}, sha256 {sha256[:8]})"

    def run(self) -> list[NDArray[np.float32]]:
        """The wanted outputs, flat, for the contents of `input`; valid until the next run."""
        self._interpreter.invoke()
        return self._outputs

    def _memory(self, index: int) -> NDArray[np.float32]:
        """A flat view of a tensor's memory. Its address does not change: nothing is allocated after the first run. (LiteRT's
        own views must be dropped before each run, so they cannot be stored.)"""
        tensor = self._interpreter.tensor(index)()
        return np.frombuffer((ctypes.c_float * tensor.size).from_address(tensor.ctypes.data), np.float32)


def _version(sha256: str) -> str:
    """The mediapipe version of a network, by its checksum."""
    return f"mediapipe {models.VERSION}" if sha256 in models.SHA256.values() else "mediapipe of unknown version"


def warp(image: NDArray[np.uint8], matrix: NDArray[np.float64], size_px: int, border: int) -> NDArray[np.uint8]:
    """OpenCV's own: OpenCV 5 interpolates exactly, OpenCV 4 at positions rounded to 1/32 px."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, matrix, (size_px, size_px), flags=flags, borderMode=border), np.uint8)


def portable_warp(image: NDArray[np.uint8], matrix: NDArray[np.float64], size_px: int, border: int) -> NDArray[np.uint8]:
    """At positions rounded to 1/32 px, with the same bits in every OpenCV from 4.10 on; 0.14 ms slower than `warp` for
    192x192."""
    steps = np.arange(size_px)
    along_px, down_px = matrix[:, 0, None] * steps, matrix[:, 1, None] * steps + matrix[:, 2, None]
    along, down = (np.rint(1024 * part).astype(np.int32) for part in (along_px, down_px))
    place = along[:, None, :] + (down + 16)[:, :, None]  # (x and y, row, column), in 1/1024 px
    x, y = place.astype(np.uint16)
    rest = (y & 992) | ((x >> 5) & 31)  # 1/32 px down and along, five bits each
    whole = np.empty((size_px, size_px, 2), np.int16)
    whole[..., 0], whole[..., 1] = place >> 10
    return np.asarray(cv2.remap(image, whole, rest, cv2.INTER_LINEAR, borderMode=border), np.uint8)


@attrs.frozen
class Roi:
    """A square in picture px: centre, side, and angle of its x axis (radians, clockwise as y points down)."""

    x_px: float
    y_px: float
    side_px: float
    angle: float

    def matrix(self, size_px: int) -> NDArray[np.float64]:
        """Affine (2, 3) from crop px (0..size_px) to picture px."""
        scale = self.side_px / size_px
        c, s = math.cos(self.angle) * scale, math.sin(self.angle) * scale
        half = size_px / 2
        return np.array([[c, -s, self.x_px - half * (c - s)], [s, c, self.y_px - half * (s + c)]])

    def crop(self, image: NDArray[np.uint8], size_px: int, border: int, warp: Warp = warp) -> NDArray[np.uint8]:
        """The region as uint8 BGRA (size_px, size_px, 4). border: cv2.BORDER_*, how to fill pixels outside of the picture.

        Warping four channels takes 0.4 of the time of three, with the same values.
        """
        matrix = self.matrix(size_px)
        # half of the rotated square's extent, plus the margin for interpolation
        reach = 0.5 * self.side_px * (abs(math.cos(self.angle)) + abs(math.sin(self.angle))) + 2
        height, width = image.shape[:2]
        x0, x1 = min(max(int(self.x_px - reach), 0), width), min(max(int(self.x_px + reach), 0), width)
        y0, y1 = min(max(int(self.y_px - reach), 0), height), min(max(int(self.y_px + reach), 0), height)
        if x1 - x0 < 1 or y1 - y0 < 1:
            x0, y0, x1, y1 = 0, 0, width, height
        matrix[0, 2] -= x0
        matrix[1, 2] -= y0
        return warp(cv2.cvtColor(image[y0:y1, x0:x1], cv2.COLOR_BGR2BGRA), matrix, size_px, border)  # type: ignore[arg-type]

    def to_picture(self, points: NDArray[np.floating], size_px: int) -> NDArray[np.float64]:
        """points (n, 2) in crop px -> picture px."""
        moved = cv2.transform(np.asarray(points, np.float64)[:, None], self.matrix(size_px))
        return np.asarray(moved[:, 0], np.float64)


def around(box_px: tuple[float, float, float, float], start: Sequence[float], end: Sequence[float], scale: float = SCALE) -> Roi:
    """Region around an upright box (x0, y0, x1, y1), turned so that start -> end (eye to eye) lies along its x axis."""
    x0, y0, x1, y1 = box_px
    angle = math.atan2(float(end[1] - start[1]), float(end[0] - start[0]))
    return Roi((x0 + x1) / 2, (y0 + y1) / 2, max(x1 - x0, y1 - y0) * scale, angle)


def fill(tensor: NDArray[np.float32], crop: NDArray[np.uint8], low: float, high: float) -> None:
    """uint8 BGRA crop (h, w, 4) -> tensor, float32 (1, h, w, 3) RGB, 0..255 mapped to low..high."""
    cv2.LUT(cv2.cvtColor(crop, cv2.COLOR_BGRA2RGB), _levels(low, high), tensor[0])


@lru_cache
def _levels(low: float, high: float) -> NDArray[np.float32]:
    levels = np.arange(256, dtype=np.float32) * np.float32((high - low) / 255)
    return (levels + np.float32(low) if low else levels).reshape(1, 256)
