"""What frames of a camera show, whatever it is: nothing at all, or a light that flashes."""

from collections import deque
from statistics import fmean, pstdev
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.transport.clock import SECOND_NS

# standard deviation of a frame, in grey levels, below which it shows nothing: a covered sensor's
# noise has 1 to 3, a dark room with a face 6 and more
FLAT_LEVELS = 4.0
COVERED_NS = SECOND_NS  # a hand passes in less
EVERY_PX = 16  # of the pixels that are looked at
# of the means of frames: difference of even and odd ones in levels, and in their own spread
FLASH_LEVELS, FLASH_RATIO = 12.0, 4.0
FLASH_FRAMES = 12


def _sample(frame: NDArray[np.uint8]) -> NDArray[Any]:
    return frame[::EVERY_PX, ::EVERY_PX]


def is_flat(frame: NDArray[np.uint8]) -> bool:
    """Whether a frame, uint8 (height, width, 3), shows nothing."""
    return float(_sample(frame)[..., 1].std()) < FLAT_LEVELS


def has_colour(frame: NDArray[np.uint8]) -> bool:
    """Whether any pixel is not exactly grey: even the noise of a sensor for colours has some."""
    return bool(np.ptp(_sample(frame), axis=2).any())


class ContentWatch:
    """Follows the content of frames."""

    def __init__(self) -> None:
        self.covered = False
        """Whether frames show nothing since COVERED_NS."""
        self.flashes = False
        """Whether every second frame is much darker: the light of an infrared camera."""
        self._flat_ns = 0  # since then
        self._means: deque[float] = deque(maxlen=FLASH_FRAMES)

    def add(self, frame: NDArray[np.uint8], t_ns: int) -> None:
        """Adds a frame, uint8 (height, width, 3), and its time."""
        self._means.append(float(_sample(frame)[..., 1].mean()))
        self.flashes = self._flash()
        if not is_flat(frame):
            self._flat_ns = 0
        elif not self._flat_ns:
            self._flat_ns = t_ns
        self.covered = bool(self._flat_ns) and t_ns - self._flat_ns >= COVERED_NS

    def _flash(self) -> bool:
        if len(self._means) < FLASH_FRAMES:
            return False
        means = list(self._means)
        even, odd = means[::2], means[1::2]
        apart = abs(fmean(even) - fmean(odd))
        return apart > FLASH_LEVELS and apart > FLASH_RATIO * max(pstdev(even), pstdev(odd), 1.0)
