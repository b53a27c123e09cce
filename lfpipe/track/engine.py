"""The protocol of the face engines, which find the eyes in a picture."""

from typing import Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.head_pose import HeadTurn


@attrs.frozen(eq=False)
class Face:
    """One face. eyes_px: float64 (2, 2), [[left x, y], [right x, y]] of the viewer's own eyes in px of the picture given,
    confidence 0..1, box_px: (x0, y0, x1, y1). iris_px: diameter of the irises, 0 if unknown or if the face is turned too
    far to compare it with the distance between the eyes. apart_px: distance between the eyes as if the head were not turned, 0 if
    unknown. lean_deg: lean towards the shoulder, clockwise in the picture.
    turn_deg: see `head_pose.head_turn`."""

    eyes_px: NDArray[np.float64]
    confidence: float
    box_px: tuple[float, float, float, float]
    iris_px: float = 0.0
    apart_px: float = 0.0
    lean_deg: float = 0.0
    turn_deg: HeadTurn = (0.0, 0.0, 0.0)


class Engine(Protocol):
    name: str
    model: str  # file name and version, for `doctor`
    rotated_deg: int  # clockwise rotation of the picture that would make detected faces upright; 0: none needed

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        """The viewer's face in uint8 (height, width, 3) BGR, or None. The engine keeps its region of interest between calls."""
        ...

    def examine(self, image: NDArray[np.uint8]) -> None:
        """Searches the last picture of `detect` for other faces, about once a second. Call it when there is time."""
        ...

    def reset(self) -> None:
        """Forgets the followed face; the next picture starts a new choice."""
        ...

    def close(self) -> None: ...
