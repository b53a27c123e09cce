"""The protocol of all displays, the display that shows nothing, and opening the one named by `--display`."""

from __future__ import annotations

import difflib
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.host.machine import has_desktop
from lfpipe.host.presentation import Presented
from lfpipe.plugins import DISPLAYS, load, plugins
from lfpipe.render.pair_layout import Pair

if TYPE_CHECKING:
    from lfpipe.render.window_system import pygame

# Keys: key -> (name that `events` reports, text of the help). The window itself handles
# "fullscreen" and "help"; the others are for the stage.
KEYS = {
    "f": ("fullscreen", "full screen on and off (F11); Esc closes the overlay, then leaves it"),
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
    "e": ("which", "which glasses do you have?"),
    "p": ("freeze", "pause or resume (space)"),
    "o": ("overlay", "rate, latency and the grid of views on and off"),
    "s": ("screenshot", "save the picture"),
    "r": ("record", "record the camera, or end it"),
    "l": ("open", "open a folder of views"),
    "i": ("open-file", "open a light field in one file"),
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


@attrs.frozen
class Pointer:
    """The mouse over the window. x, y: share of the window, from its top left corner. left, right: buttons held. wheel: steps
    away from the person since the last call."""

    x: float = 0.5
    y: float = 0.5
    left: bool = False
    right: bool = False
    wheel: int = 0

    def at_px(self, size_px: tuple[int, int]) -> tuple[int, int]:
        """The place in a window of (width, height) px."""
        return round(self.x * size_px[0]), round(self.y * size_px[1])


@attrs.frozen
class BarState:
    """What the bar shows. depth: 0 for comfort, 1 for true depth. recording: whether the camera is being recorded. without:
    events of entries that the session does not have."""

    depth: float = 0.0
    recording: bool = False
    without: frozenset[str] = frozenset()


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

    def pointer(self) -> Pointer:
        """The mouse, as the last call of `events` left it."""
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

    def progress(self, share: float | None) -> None:
        """Shows a thin line as long as a share of the picture's width along its bottom; None removes it."""
        ...

    def menu(self, draw: Callable[[tuple[int, int]], pygame.Surface] | None) -> None:
        """Shows over the pictures what draw makes for (width, height) px; None removes it. A click on it is "click X Y"."""
        ...

    def bar(self, state: BarState) -> None:
        """Sets what the bar shows that appears when the mouse moves."""
        ...

    def title(self, name: str) -> None:
        """Sets the name of the scene on show."""
        ...

    def width_mm(self) -> float | None:
        """Current width of the picture on the screen; None if the size of a pixel is unknown."""
        ...

    def close(self) -> None: ...


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

    def pointer(self) -> Pointer:
        return Pointer()

    def notices(self) -> list[DisplayNotice]:
        return []

    def overlay(self, lines: list[str], inset: NDArray[np.uint8] | None = None) -> None:
        pass

    def say(self, lines: list[str]) -> None:
        """Does nothing."""

    def progress(self, share: float | None) -> None:
        """Does nothing."""

    def menu(self, draw: object) -> None:
        """Does nothing."""

    def bar(self, state: object) -> None:
        """Does nothing."""

    def title(self, name: str) -> None:
        """Does nothing."""

    def width_mm(self) -> None:
        pass

    def close(self) -> None:
        pass


HINT = "h shows the keys, g tests your glasses"
FORMS = "window, fullscreen, none or file:OUT.mkv (or .mp4)"


def _answers(family: int, address: str | tuple[str, int]) -> bool:
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            probe.connect(address)
        return True
    except OSError:
        return False


def _x_answers(display: str) -> bool:
    host, colon, rest = display.rpartition(":")
    number = rest.partition(".")[0]
    if not colon or not number.isdigit():
        return False
    if host in ("", "unix"):
        path = f"/tmp/.X11-unix/X{number}"
        return _answers(socket.AF_UNIX, path) or _answers(socket.AF_UNIX, "\0" + path)
    return _answers(socket.AF_INET, (host, 6000 + int(number)))


def has_display() -> bool:
    """Whether a window can be opened: the environment names a display server, and it answers."""
    if has_desktop() or os.environ.get("SDL_VIDEODRIVER") in ("dummy", "offscreen"):
        return True
    if wayland := os.environ.get("WAYLAND_DISPLAY"):
        where = Path(os.environ.get("XDG_RUNTIME_DIR", "")) / wayland
        if _answers(socket.AF_UNIX, str(where)):
            return True
    return _x_answers(os.environ.get("DISPLAY", ""))


def check_display(spec: str, monitor: str = "") -> None:
    """Raises UserError if spec is no display, needs a missing screen or monitor, or names a file that cannot be written. monitor:
    `screen.monitor`.
    """
    if spec in ("window", "fullscreen"):
        if not has_display():
            named = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
            why = f"{named} does not answer" if named else "neither WAYLAND_DISPLAY nor DISPLAY is set"
            remedy = "use --display none or --display file:OUT.mkv, or run on a desktop"
            raise UserError(f"--display {spec}: no screen here ({why})", remedy)
        if monitor:
            from lfpipe.render.monitors import detect_monitors, find_monitor

            find_monitor(monitor, detect_monitors()[1])
    elif spec.startswith("file:") and len(spec) > len("file:"):
        from lfpipe.render.file_display import check_file

        check_file(Path(spec.removeprefix("file:")).expanduser())
    elif spec.partition(":")[0] in plugins(DISPLAYS):
        load(DISPLAYS, spec.partition(":")[0])
    elif spec != "none":
        close = difflib.get_close_matches(spec.partition(":")[0], ["window", "fullscreen", "none", "file"], 1, 0.5)
        hint = f" (did you mean {close[0] + (':OUT.mkv' if close[0] == 'file' else '')!r}?)" if close else ""
        raise UserError(f"--display {spec!r}: not a display{hint}", f"use one of {FORMS}")


def part_of(path: Path, part: int) -> Path:
    """The path of a restarted process's part of a video: earlier parts are not overwritten."""
    return path.with_stem(f"{path.stem}.{part + 1}") if part else path


def open_display(
    spec: str, size_px: tuple[int, int], title: str, rate_hz: float, monitor: str = "", part: int = 0, code: str = ""
) -> Display:
    """The display that spec names: window, fullscreen, none, file:OUT.mkv.

    size_px: (width, height) of the pictures; rate_hz: their highest rate, and the rate of a video; monitor: `screen.monitor`;
    part: how often the process that writes a video was restarted; code: the only keys that a window accepts, to end it. Raises
    UserError as `check_display` does, and if the window cannot be opened.
    """
    check_display(spec)
    if spec == "none":
        from lfpipe.render.display import NullDisplay

        return NullDisplay()
    if spec.startswith("file:"):
        from lfpipe.render.file_display import FileDisplay

        return FileDisplay(part_of(Path(spec.removeprefix("file:")).expanduser(), part), size_px, rate_hz)
    if spec not in ("window", "fullscreen"):
        name, _, argument = spec.partition(":")
        display: Display = load(DISPLAYS, name)(argument, size_px, title, rate_hz)
        return display
    from lfpipe.render.window import Window
    from lfpipe.render.window_system import KeyLock

    if code:
        return Window(size_px, title, spec == "fullscreen", monitor, lock=KeyLock(code))
    return Window(size_px, f"{title} ({HINT})", spec == "fullscreen", monitor, HINT)
