"""No display: pictures are made and dropped, for measurements and for machines without a screen."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from lfpipe.host.presentation import Presented


class NullDisplay:
    """Takes pictures and shows nothing."""

    def show(self, picture: NDArray[np.uint8]) -> int:
        return time.monotonic_ns()

    blanks_by = ""

    def presented(self) -> list[Presented]:
        return []

    def nominal_hz(self) -> float:
        return 0.0

    def events(self) -> list[str]:
        return []

    def notices(self) -> list[str]:
        return []

    def overlay(self, lines: list[str], inset: NDArray[np.uint8] | None = None) -> None:
        pass

    def width_mm(self) -> None:
        pass

    def close(self) -> None:
        pass
