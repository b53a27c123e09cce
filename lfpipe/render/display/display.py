"""The base class of displays, which shows nothing, and that of `--display none`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.presentation import Presented
from lfpipe.render.display.overlay import Event, Overlay, Pointer

if TYPE_CHECKING:
    from lfpipe.render.synthesis.pair_layout import Pair


@attrs.frozen
class DisplayNotice:
    """A notice for the user."""

    text: str
    lost: bool
    """The display's file ended early, because of a full disk or the like."""


class Display:
    """Accepts pictures and shows nothing."""

    pointer = Pointer()
    """The pointer, updated by `events`."""
    knows_rows = True
    """Whether it knows the screen rows of its pictures."""
    waiting: Callable[[], AbstractContextManager[None]] = nullcontext
    """Entered for calls in which the window system may keep the stage waiting."""
    fds: Sequence[int] | None = None
    """Descriptors that can be read when `events` has news; None if it must be asked at every
    refresh, or needs a picture then."""

    @property
    def vblank_source(self) -> str:
        """What reports presentations: x_present; empty for nothing."""
        return ""

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        """Shows uint8 (height, width, 3) BGR, scaled to fit; returns the submission time, monotonic
        ns.

        pair: the left and right view that picture consists of, and "side-by-side" or
        "row-interleaved": for a screen that must show them in its own pixels.
        """
        return time.monotonic_ns()

    def presented(self) -> list[Presented]:
        """The vblanks that showed pictures, reported since the last call. serial: the
        picture's number, 1 for the first call of `show`.
        """
        return []

    def nominal_hz(self) -> float:
        """The refresh rate that the screen claims; asked only if vblanks are reported."""
        return 0.0

    def events(self) -> list[Event]:
        """User input since the last call: actions of keys, events of overlay items, "load" for a
        dropped file. Call it often: it keeps a window responsive.
        """
        return []

    def notices(self) -> list[DisplayNotice]:
        """Notices since the last call, each once."""
        return []

    def overlay(self, overlay: Overlay) -> None:
        """Sets the overlay of this and the following pictures."""

    def title(self, name: str) -> None:
        """Sets the name of the current scene."""

    def shown_px(self, picture_px: tuple[int, int]) -> tuple[int, int]:
        """The pixels that a picture covers now; both sizes are (width, height). A smaller picture
        than picture_px is enough then.
        """
        return picture_px

    def width_mm(self) -> float | None:
        """Current width of the picture on the screen; None if the size of a pixel is unknown."""
        return None

    def close(self) -> None:
        """Closes the display and completes a file."""


class NoDisplay(Display):
    """Shows nothing, and has no events."""

    fds = ()
