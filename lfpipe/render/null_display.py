"""No display: pictures are dropped. For measurements and for machines without a screen."""

import time

import numpy as np
from numpy.typing import NDArray

from lfpipe.host.presentation import Presented
from lfpipe.render.display import DisplayNotice
from lfpipe.render.pair_layout import Pair


class NullDisplay:
    """Accepts pictures and shows nothing."""

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        return time.monotonic_ns()

    blanks_by = ""

    def presented(self) -> list[Presented]:
        return []

    def nominal_hz(self) -> float:
        return 0.0

    def events(self) -> list[str]:
        return []

    def notices(self) -> list[DisplayNotice]:
        return []

    def overlay(self, lines: list[str], inset: NDArray[np.uint8] | None = None) -> None:
        pass

    def say(self, lines: list[str]) -> None:
        """Does nothing."""

    def menu(self, draw: object) -> None:
        """Does nothing."""

    def title(self, name: str) -> None:
        """Does nothing."""

    def width_mm(self) -> None:
        pass

    def close(self) -> None:
        pass
