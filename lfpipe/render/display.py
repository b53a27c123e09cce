"""The protocol of all displays: window, file and null display."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.presentation import Presented
from lfpipe.render.pair_layout import Pair

if TYPE_CHECKING:
    from lfpipe.render.sdl import pygame

# Keys: key -> (name that `events` reports, text of the help). The window itself handles
# "fullscreen" and "help"; the others are for the stage.
KEYS = {
    "f": ("fullscreen", "full screen on and off (F11, Esc leaves it)"),
    "+": ("alpha+", "more head movement from view to view"),
    "-": ("alpha-", "less head movement from view to view"),
    "c": ("recentre", "look straight ahead from where you are now"),
    "]": ("depth+", "the scene goes back, behind the screen"),
    "[": ("depth-", "the scene comes forward"),
    "a": ("automatic", "depth and head movement automatic again"),
    "m": ("mode", "another way to give each eye its view"),
    "g": ("glasses", "glasses test: does each eye see its own?"),
    "x": ("swap", "swap the eyes"),
    "d": ("half-turn", "exchange near and far"),
    "p": ("freeze", "pause or resume (space)"),
    "o": ("overlay", "rate, latency and the grid of views on and off"),
    "s": ("screenshot", "save the picture"),
    "Tab": ("choose", "choose a scene by its picture"),
    "PgDn": ("next", "the next scene of the list"),
    "PgUp": ("previous", "the previous scene"),
    "h": ("help", "this help on and off (?)"),
    "q": ("quit", "quit"),
}


@attrs.frozen
class DisplayNotice:
    """lost: the display's file ended early, because of a full disk or the like."""

    text: str
    lost: bool


class Display(Protocol):
    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        """Puts uint8 (height, width, 3) BGR on the screen, scaled to fit; returns the time of hand-over, monotonic ns.

        pair: the left and right view that picture consists of, and "side-by-side" or "row-interleaved": for a screen that must
        show them in its own pixels.
        """
        ...

    @property
    def blanks_by(self) -> str:
        """Protocol that reports when pictures are shown: wp_presentation, wl_surface.frame or x_present; empty if none does."""
        ...

    def presented(self) -> list[Presented]:
        """The vertical blanks that showed pictures, reported since the last call. serial: the picture's number, 1 for the first
        call of `show`.
        """
        ...

    def nominal_hz(self) -> float:
        """The refresh rate that the screen claims; asked only if blanks are reported."""
        ...

    def events(self) -> list[str]:
        """Keys and clicks since the last call: names from KEYS, of arrows and Enter, "drop PATH", "click X Y". Call it often: it
        keeps a window alive.
        """
        ...

    def notices(self) -> list[DisplayNotice]:
        """Notices for people since the last call, each once."""
        ...

    def overlay(self, lines: list[str], inset: NDArray[np.uint8] | None = None) -> None:
        """Draws text over the following pictures, with a small picture, uint8 (h, w, 3) BGR, below it; no lines remove both."""
        ...

    def say(self, lines: list[str]) -> None:
        """Shows short lines at the bottom of the following pictures, until the next call."""
        ...

    def menu(self, draw: Callable[[tuple[int, int]], pygame.Surface] | None) -> None:
        """Shows over the pictures what draw makes for (width, height) px; None removes it. A click on it is "click X Y"."""
        ...

    def title(self, name: str) -> None:
        """Sets the name of the scene on show."""
        ...

    def width_mm(self) -> float | None:
        """Current width of the picture on the screen; None if the size of a pixel is unknown."""
        ...

    def close(self) -> None: ...
