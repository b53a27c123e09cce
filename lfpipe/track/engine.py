"""Face engines find the eyes in a picture: their protocol, and what they return."""

import math
from typing import Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

LIMIT_PX = 1e6  # beyond every camera's picture
MIN_APART_PX = 0.5  # between the eyes; a tracked face has at least 4 px
# distance between the eyes over the longer side of the face;
# 0.3 to 0.5 in faces, 1 in those of a bad fit
WIDEST = 1.5


@attrs.frozen(eq=False)
class Face:
    """One face. eyes_px: float64 (2, 2), [[left x, y], [right x, y]] of the viewer's own eyes in px
    of the picture given, confidence 0..1, box_px: (x0, y0, x1, y1). eye_distance_px: distance
    between the eyes as if the head were not turned, 0 if unknown.
    lean_deg: lean towards the shoulder, clockwise in the picture.
    head_px: float (10, 3), `lfpipe.eyes.HEAD_POINTS` in the picture: right, down, away from the
    camera; None if unknown.
    """

    eyes_px: NDArray[np.float64]
    confidence: float
    box_px: tuple[float, float, float, float]
    eye_distance_px: float = 0.0
    lean_deg: float = 0.0
    head_px: NDArray[np.float64] | None = None

    @property
    def plausible(self) -> bool:
        """Whether all numbers are finite and fit each other; otherwise no face is better than this
        one.
        """
        (lx, ly), (rx, ry) = self.eyes_px.tolist()
        x0, y0, x1, y1 = self.box_px
        numbers = (lx, ly, rx, ry, x0, y0, x1, y1, self.eye_distance_px, self.confidence)
        if math.isnan(sum(numbers)) or max(map(abs, numbers)) > LIMIT_PX:
            return False
        side_px = max(x1 - x0, y1 - y0)
        eye_distance_px = math.hypot(lx - rx, ly - ry)
        widest_px = WIDEST * side_px
        known = self.eye_distance_px == 0 or MIN_APART_PX <= self.eye_distance_px <= widest_px
        return MIN_APART_PX <= eye_distance_px <= widest_px and known and 0 <= self.confidence <= 1


class Engine(Protocol):
    name: str
    model: str  # file name and version, for `doctor`
    # clockwise rotation of the picture that would make detected faces upright; 0: none needed
    rotated_deg: int

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        """The viewer's face in uint8 (height, width, 3) BGR, or None.

        The engine keeps its region of interest between calls.
        """
        ...

    def examine(self, image: NDArray[np.uint8]) -> None:
        """Searches the last picture of `detect` for other faces, about once a second.

        Call it when there is time.
        """
        ...

    def reset(self) -> None:
        """Forgets the followed face; the next picture starts a new choice."""
        ...

    def close(self) -> None: ...
