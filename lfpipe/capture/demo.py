"""The demo's viewer: a portrait moves on a known smooth path. Needs no camera."""

import math
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.recordings import Schedule
from lfpipe.errors import UserError

PORTRAIT = Path(__file__).with_name("portrait.jpg")  # in the public domain: portrait.md
# Mean of the 16 landmarks around each eye in the portrait, the left eye of the sitter first, as
# FaceMesh finds them.
PORTRAIT_EYES_PX = np.array([[308.0, 188.1], [220.2, 193.0]])
EYE_DISTANCE_PX = 65.0  # in a frame of 640x480: a viewer 600 mm from a webcam
EYE_LINE = 0.47  # share of the frame's height, at the middle of the path
FRAME_PX = (640, 480)  # lengths in px refer to this size; other sizes scale


def _scale(width_px: int, height_px: int) -> float:
    """The scale of lengths in a frame of that size."""
    return min(width_px / FRAME_PX[0], height_px / FRAME_PX[1])


def _portrait_scale(width_px: int, height_px: int) -> float:
    return (
        EYE_DISTANCE_PX
        * _scale(width_px, height_px)
        / float(np.linalg.norm(PORTRAIT_EYES_PX[0] - PORTRAIT_EYES_PX[1]))
    )


def _head_matrix(t_s: float, width_px: int, height_px: int) -> NDArray[np.float64]:
    """(2, 3): from px about the point between the eyes, in a head of mean size, to px of the frame
    at time t_s.

    Sums of sines: smooth, endless, and slow enough for a head (at most 90 px/s in a frame of
    640x480).
    """
    turn = 2 * math.pi * t_s
    scale = _scale(width_px, height_px)
    right_px = 62 * math.sin(turn / 7.3) + 14 * math.sin(turn / 3.1)
    down_px = 16 * math.sin(turn / 5.9 + 1.0)
    roll_rad = 0.05 * math.sin(turn / 6.7 + 0.4)
    size = 1 + 0.04 * math.sin(turn / 9.1)
    cos, sin = size * math.cos(roll_rad), size * math.sin(roll_rad)
    x, y = width_px / 2 + scale * right_px, EYE_LINE * height_px + scale * down_px
    return np.array([[cos, -sin, x], [sin, cos, y]])


def demo_eyes_px(
    t_s: float, width_px: int = FRAME_PX[0], height_px: int = FRAME_PX[1]
) -> NDArray[np.float64]:
    """Eyes in the frame of time t_s: (2, 2) px, [[left x, left y], [right x, right y]], the
    sitter's own left and right.
    """
    about_px = (PORTRAIT_EYES_PX - PORTRAIT_EYES_PX.mean(axis=0)) * _portrait_scale(
        width_px, height_px
    )
    matrix = _head_matrix(t_s, width_px, height_px)
    return np.asarray(about_px @ matrix[:, :2].T + matrix[:, 2], np.float64)


def backdrop(width_px: int, height_px: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """The scaled portrait with blurred surroundings: (BGR picture, point between the eyes).

    Larger than a frame by the margin that the path needs on each side.
    """
    portrait = cv2.imread(str(PORTRAIT), cv2.IMREAD_COLOR)
    if portrait is None:
        raise UserError(f"demo: {PORTRAIT} cannot be read", "install lfpipe again")
    scale = _portrait_scale(width_px, height_px)
    small = cv2.resize(portrait, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    rows, cols = small.shape[:2]
    middle = PORTRAIT_EYES_PX.mean(axis=0) * scale
    reach = np.array([width_px, height_px]) * 0.72
    left, top = (math.ceil(v) for v in np.maximum(reach - middle, 0))
    right, bottom = (math.ceil(v) for v in np.maximum(reach - (np.array([cols, rows]) - middle), 0))
    wide = cv2.copyMakeBorder(small, top, bottom, left, right, cv2.BORDER_REPLICATE)
    soft = cv2.GaussianBlur(wide, (0, 0), 0.05 * height_px)
    mask = np.zeros((rows, cols), np.float32)
    edge = max(2, round(0.06 * rows))
    mask[edge:, edge:-edge] = 1.0
    mask = cv2.GaussianBlur(mask, (0, 0), edge / 2.5, borderType=cv2.BORDER_REPLICATE)
    mask = cv2.copyMakeBorder(mask, top, bottom, left, right, cv2.BORDER_REPLICATE)[..., None]
    mixed = wide * mask + soft * (1 - mask)
    return np.asarray(mixed + 0.5, np.uint8), middle + np.array([left, top])


class DemoSource:
    """Frames of camera.width_px x camera.height_px at camera.rate_hz, endlessly; frame k shows the
    head at k / rate_hz.
    """

    def __init__(self, camera: config.Camera) -> None:
        """Raises UserError if the portrait is missing."""
        self._size = camera.width_px, camera.height_px
        picture, self._middle = backdrop(*self._size)
        # Warping four channels takes 0.65 ms, three 1.65 (640x480, OpenCV 5); the values are equal.
        self._picture = cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA)
        self._warped: NDArray[np.uint8] = np.empty((0, 0, 4), np.uint8)
        self._schedule = Schedule(camera.nominal_hz)
        self._seq = self._start_ns = 0
        self.info = SourceInfo("demo", self._size, camera.nominal_hz, live=False)

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; out may have another size than the camera's.

        Never returns None.
        """
        height_px, width_px = out.shape[:2]
        after_ns = self._schedule.due_ns(self._seq)
        matrix = _head_matrix(after_ns / 1e9, *self._size)
        matrix[:, 2] -= matrix[:, :2] @ self._middle
        fit = np.diag([width_px / self._size[0], height_px / self._size[1]])
        if self._warped.shape[:2] != out.shape[:2]:
            self._warped = np.empty((height_px, width_px, 4), np.uint8)
        cv2.warpAffine(
            self._picture,
            fit @ matrix,
            (width_px, height_px),
            dst=self._warped,
            borderMode=cv2.BORDER_REPLICATE,
        )
        cv2.cvtColor(self._warped, cv2.COLOR_BGRA2BGR, dst=out)
        self._start_ns = self._start_ns or time.monotonic_ns()
        self._seq += 1
        return Frame(self._seq - 1, self._start_ns + after_ns, 0)

    def close(self) -> None:
        pass
