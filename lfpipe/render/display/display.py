"""What a display is, and the one that shows nothing."""

import time

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.presentation import Presented
from lfpipe.render.display.overlay import Event, Overlay, Pointer
from lfpipe.render.synthesis.pair_layout import Pair


@attrs.frozen
class DisplayNotice:
    """A notice for people.

    lost: the display's file ended early, because of a full disk or the like.
    """

    text: str
    lost: bool


class Display:
    """Accepts pictures and shows nothing: `--display none`, and what other displays replace."""

    pointer = Pointer()
    """The mouse, as the last call of `events` left it."""
    knows_rows = True
    """Whether it knows which rows of the screen its pictures take."""

    @property
    def vblank_source(self) -> str:
        """Protocol that reports now when pictures are shown: wp_presentation, wl_surface.frame or
        x_present; empty if none does.
        """
        return ""

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        """Puts uint8 (height, width, 3) BGR on the screen, scaled to fit; returns the time of
        hand-over, monotonic ns.

        pair: the left and right view that picture consists of, and "side-by-side" or
        "row-interleaved": for a screen that must show them in its own pixels.
        """
        return time.monotonic_ns()

    def presented(self) -> list[Presented]:
        """The vertical blanks that showed pictures, reported since the last call. serial: the
        picture's number, 1 for the first call of `show`.
        """
        return []

    def nominal_hz(self) -> float:
        """The refresh rate that the screen claims; asked only if vblanks are reported."""
        return 0.0

    def events(self) -> list[Event]:
        """What a person did since the last call: actions of keys, events of the overlay's items,
        "load" for a dropped file, "click" on the picture. Call it often: it keeps a window alive.
        """
        return []

    def notices(self) -> list[DisplayNotice]:
        """Notices since the last call, each once."""
        return []

    def overlay(self, overlay: Overlay) -> None:
        """Sets what lies over this and the following pictures."""

    def title(self, name: str) -> None:
        """Sets the name of the scene on show."""

    def width_mm(self) -> float | None:
        """Current width of the picture on the screen; None if the size of a pixel is unknown."""
        return None

    def close(self) -> None:
        """Ends the display; a file is complete then."""
