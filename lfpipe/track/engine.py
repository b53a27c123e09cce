"""What finds the eyes in a picture: the protocol of the face engines."""

from __future__ import annotations

from typing import Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.head_pose import HeadTurn


@attrs.frozen(eq=False)
class Face:
    """One face. eyes_px: float64 (2, 2), [[left x, y], [right x, y]] of the viewer's own eyes in px of the picture given,
    confidence 0..1, box_px: (x0, y0, x1, y1). iris_px: diameter of the irises, 0 where it is not known or the face is turned to
    the side, so that it does not compare with the distance between the eyes. apart_px: distance between the eyes as it would be
    if the head were not turned, 0 where it is not known. lean_deg: towards the shoulder, clockwise in the picture.
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
    rotated_deg: int  # clockwise rotation of the picture that would put the faces seen upright; 0: no such face

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        """The viewer's face in uint8 (height, width, 3) BGR, or None. Keeps its own region of interest between calls."""
        ...

    def examine(self, image: NDArray[np.uint8]) -> None:
        """Searches the picture last given to `detect` for other faces, about once a second. Call it when there is time."""
        ...

    def reset(self) -> None:
        """Forgets the followed face; the next picture chooses again."""
        ...

    def close(self) -> None: ...
