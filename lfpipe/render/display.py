"""Where pictures go: the protocol that the window, the file and the null display share."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from lfpipe.host.presentation import Presented
from lfpipe.render.pair_layout import Pair

if TYPE_CHECKING:
    from lfpipe.render.sdl import pygame

# What a viewer may press: key -> (name that `events` reports, what the help says). The window itself carries out
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
    "p": ("freeze", "pause or resume (space)"),
    "o": ("overlay", "rate, latency and the grid of views on and off"),
    "s": ("screenshot", "save the picture"),
    "Tab": ("choose", "choose a scene by its picture"),
    "PgDn": ("next", "the next scene of the list"),
    "PgUp": ("previous", "the previous scene"),
    "h": ("help", "this help on and off (?)"),
    "q": ("quit", "quit"),
}


class Display(Protocol):
    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        """Puts uint8 (height, width, 3) BGR on the screen, scaled to fit; returns when it was handed over (monotonic).

        pair: the left and the right view that picture consists of, how: "side-by-side" or "row-interleaved", for a screen that
        must show them in its own pixels.
        """
        ...

    @property
    def blanks_by(self) -> str:
        """Who reports when pictures are shown: wp_presentation, wl_surface.frame, x_present; empty: nobody does."""
        ...

    def presented(self) -> list[Presented]:
        """The vertical blanks that showed pictures, as far as they became known since the last call. serial: the pictures'
        number, 1 for the first call of `show`."""
        ...

    def nominal_hz(self) -> float:
        """The refresh rate that the screen claims; asked only where blanks are reported."""
        ...

    def events(self) -> list[str]:
        """What the viewer pressed since the last call: names from KEYS, of arrows and Enter, "drop PATH", "click X Y". Call it
        often: it keeps a window alive."""
        ...

    def notices(self) -> list[str]:
        """What a person should know of the output since the last call, each once: a full disk ended it, ..."""
        ...

    def overlay(self, lines: list[str], inset: NDArray[np.uint8] | None = None) -> None:
        """Text laid over the following pictures, with a small picture, uint8 (h, w, 3) BGR, below it; no lines take both away."""
        ...

    def say(self, lines: list[str]) -> None:
        """Short lines at the bottom of the following pictures, until others are given."""
        ...

    def menu(self, draw: Callable[[tuple[int, int]], pygame.Surface] | None) -> None:
        """Lays over the pictures what draw makes for a room of (width, height) px, until None. A click on it is "click X Y"."""
        ...

    def title(self, name: str) -> None:
        """The name of the scene that is shown now."""
        ...

    def width_mm(self) -> float | None:
        """Width of the picture as it is shown now; None where nobody knows how large a pixel is."""
        ...

    def close(self) -> None: ...
