"""Face engines find the eyes in a picture: their protocol, and what they return."""

import math
from typing import Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.eyes import MIN_EYE_DISTANCE_PX, is_plausible_px
from lfpipe.plugins import ENGINES, make

# Eye distance over the longer side of the face: 0.3 to 0.5 in faces, 1 for a bad fit.
MAX_EYE_DISTANCE = 1.5


@attrs.frozen(eq=False)
class Face:
    """One face, in px of the picture given."""

    eyes_px: NDArray[np.float64]
    """float64 (2, 2): [[left x, y], [right x, y]] of the viewer's own eyes."""
    confidence: float
    """0 to 1."""
    box_px: tuple[float, float, float, float]
    """(x0, y0, x1, y1)."""
    eye_distance_px: float = 0.0
    """Distance between the eyes as if the head were not turned; 0: unknown."""
    lean_deg: float = 0.0
    """Lean towards the shoulder, clockwise in the picture."""
    head_px: NDArray[np.float64] | None = None
    """float (10, 3): `lfpipe.eyes.HEAD_POINTS`, right, down, away from the camera; None: unknown.
    """

    @property
    def plausible(self) -> bool:
        """Whether all values are finite and consistent; if not, treat the frame as having no
        face.
        """
        (lx, ly), (rx, ry) = self.eyes_px.tolist()
        x0, y0, x1, y1 = self.box_px
        if not is_plausible_px(lx, ly, rx, ry, x0, y0, x1, y1, self.eye_distance_px):
            return False
        max_px = MAX_EYE_DISTANCE * max(x1 - x0, y1 - y0)
        distances_px = math.hypot(lx - rx, ly - ry), self.eye_distance_px or MIN_EYE_DISTANCE_PX
        return 0 <= self.confidence <= 1 and all(
            MIN_EYE_DISTANCE_PX <= distance_px <= max_px for distance_px in distances_px
        )


class Engine(Protocol):
    """Finds the viewer's face in each picture, and follows it."""

    name: str
    model: str
    """File name and version, for `doctor`."""
    rotated_deg: int
    """Clockwise rotation of the picture that would make detected faces upright; 0: none needed."""

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
        """Stops following; the next picture starts a new choice."""
        ...

    def close(self) -> None: ...


def make_engine(track: Track, portable: bool = False) -> Engine:
    """The engine that track names, ready. Its libraries are imported only now. portable: see
    `LitertNetworks`.

    Raises UserError if its libraries or models are missing or have another version.
    """
    name: str = track.engine
    if name == "litert":
        from lfpipe.track.face_networks import LitertNetworks
        from lfpipe.track.litert_engine import LitertEngine

        return LitertEngine(LitertNetworks(portable))
    if name == "mediapipe":
        from lfpipe.track.mediapipe_engine import MediapipeEngine

        return MediapipeEngine()
    engine: Engine = make(ENGINES, name, track)
    return engine
