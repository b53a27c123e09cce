"""A face engine, a filter and a display, as small as they can be."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.render.display.display import Display
from lfpipe.render.synthesis.anaglyph import Pair
from lfpipe.track.engine import Face
from lfpipe.track.filters.base import EyeFilter, Points


class CentreEngine:
    """`--set track.engine=centre`: a face in the middle of every picture, a tenth of its width
    between the eyes.
    """

    name = "centre"
    model = "none"
    rotated_deg = 0

    def __init__(self, track: Track) -> None:
        pass

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        height, width = image.shape[:2]
        x, y, eye_distance = width / 2, height / 2, width / 10
        # the viewer's own left eye is at the larger x
        eyes = np.array([[x + eye_distance / 2, y], [x - eye_distance / 2, y]])
        return Face(
            eyes,
            1.0,
            (x - eye_distance, y - eye_distance, x + eye_distance, y + eye_distance),
            eye_distance_px=eye_distance,
        )

    def examine(self, image: NDArray[np.uint8]) -> None:
        pass

    def reset(self) -> None:
        pass

    def close(self) -> None:
        pass


class Newest(EyeFilter):
    """`--set track.filter=newest`: the newest measurement, at rest."""

    def _start(self, t_ns: int, measured: Points) -> None:
        pass

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        return measured, np.zeros((2, 2))


def newest(track: Track, device_latency_s: float) -> Newest:
    return Newest()


class CountDisplay(Display):
    """`--display count:FILE`: writes the number of pictures to FILE when the session ends."""

    def __init__(self, argument: str, size_px: tuple[int, int], title: str, rate_hz: float) -> None:
        self._file = Path(argument)
        self._count = 0

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        self._count += 1
        return super().show(picture, pair, how)

    def close(self) -> None:
        self._file.write_text(str(self._count))
