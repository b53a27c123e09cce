"""Where pictures go: the protocol that the window, the file and the null display share."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Display(Protocol):
    def show(self, picture: NDArray[np.uint8]) -> int:
        """Puts uint8 (height, width, 3) BGR on the screen, scaled to fit; returns t_presented_ns (monotonic)."""
        ...

    def events(self) -> list[str]:
        """What the viewer pressed since the last call: names from KEYS in `render/window.py`, or "quit"."""
        ...

    def overlay(self, lines: list[str]) -> None:
        """Text laid over the following pictures; an empty list takes it away."""
        ...

    def close(self) -> None: ...
