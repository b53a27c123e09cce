"""What a display is, the one that shows nothing, and opening the one named by `--display`."""

import contextlib
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.host.machine import has_desktop
from lfpipe.host.presentation import Presented
from lfpipe.plugins import DISPLAYS, load, plugins
from lfpipe.render.overlay import Overlay, Pointer
from lfpipe.render.pair_layout import Pair


@attrs.frozen
class DisplayNotice:
    """A notice for people. lost: the display's file ended early, because of a full disk or the like."""

    text: str
    lost: bool


class Display:
    """Accepts pictures and shows nothing: `--display none`, and what other displays replace. pointer: the mouse, as the last call
    of `events` left it."""

    pointer = Pointer()

    @property
    def blanks_by(self) -> str:
        """Protocol that reports when pictures are shown: wp_presentation, wl_surface.frame or x_present; empty if none does."""
        return ""

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        """Puts uint8 (height, width, 3) BGR on the screen, scaled to fit; returns the time of hand-over, monotonic ns.

        pair: the left and right view that picture consists of, and "side-by-side" or "row-interleaved": for a screen that must
        show them in its own pixels.
        """
        return time.monotonic_ns()

    def presented(self) -> list[Presented]:
        """The vertical blanks that showed pictures, reported since the last call. serial: the picture's number, 1 for the first
        call of `show`."""
        return []

    def nominal_hz(self) -> float:
        """The refresh rate that the screen claims; asked only if blanks are reported."""
        return 0.0

    def events(self) -> list[str]:
        """Keys, clicks and drops since the last call: the events of `overlay.KEYS` and of the overlay's items, names of arrows,
        "close", "load PATH", "click X Y" in px of the picture. Call it often: it keeps a window alive."""
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


HINT = "h shows the keys, g tests your glasses"
FORMS = "window, fullscreen, none or file:OUT.mkv (or .mp4)"


def _sockets() -> Iterator[tuple[socket.AddressFamily, str | tuple[str, int]]]:
    """Where the display servers that the environment names listen."""
    if wayland := os.environ.get("WAYLAND_DISPLAY"):
        yield socket.AF_UNIX, str(Path(os.environ.get("XDG_RUNTIME_DIR", "")) / wayland)
    host, colon, rest = os.environ.get("DISPLAY", "").rpartition(":")
    number = rest.partition(".")[0]
    if colon and number.isdigit() and host in ("", "unix"):
        path = f"/tmp/.X11-unix/X{number}"
        yield from ((socket.AF_UNIX, path), (socket.AF_UNIX, "\0" + path))
    elif colon and number.isdigit():
        yield socket.AF_INET, (host, 6000 + int(number))


def has_display() -> bool:
    """Whether a window can be opened: the environment names a display server, and it answers."""
    if has_desktop() or os.environ.get("SDL_VIDEODRIVER") in ("dummy", "offscreen"):
        return True
    for family, address in _sockets():
        with contextlib.suppress(OSError), socket.socket(family) as probe:
            probe.settimeout(1.0)
            probe.connect(address)
            return True
    return False


def check_display(spec: str, monitor: str = "") -> None:
    """Raises UserError if spec is no display, needs a missing screen or monitor, or names a file that cannot be written. monitor:
    `screen.monitor`."""
    name, _, argument = spec.partition(":")
    if spec in ("window", "fullscreen"):
        if not has_display():
            named = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
            why = (
                f"{named} does not answer"
                if named
                else "neither WAYLAND_DISPLAY nor DISPLAY is set"
            )
            remedy = "use --display none or --display file:OUT.mkv, or run on a desktop"
            raise UserError(f"--display {spec}: no screen here ({why})", remedy)
        if monitor:
            from lfpipe.render.monitors import detect_monitors, find_monitor

            find_monitor(monitor, detect_monitors()[1])
    elif name == "file" and argument:
        from lfpipe.render.file_display import check_file

        check_file(Path(argument).expanduser())
    elif name in plugins(DISPLAYS):
        load(DISPLAYS, name)
    elif spec != "none":
        raise UserError(f"--display {spec!r}: not a display", f"use one of {FORMS}")


def open_display(
    spec: str,
    size_px: tuple[int, int],
    title: str,
    rate_hz: float,
    monitor: str = "",
    part: int = 0,
    code: str = "",
) -> Display:
    """The display that spec names: window, fullscreen, none, file:OUT.mkv.

    size_px: (width, height) of the pictures; rate_hz: their highest rate, and the rate of a video; monitor: `screen.monitor`;
    part: how often the process that writes a video was restarted, which makes the next file; code: the only keys that a window
    accepts, to end it. Raises UserError if the display, which `check_display` has accepted, cannot be opened.
    """
    name, _, argument = spec.partition(":")
    if spec == "none":
        return Display()
    if spec in ("window", "fullscreen"):
        from lfpipe.render.window import Window

        return Window(
            size_px, title if code else f"{title} ({HINT})", spec == "fullscreen", monitor, code
        )
    if name == "file":
        from lfpipe.render.file_display import FileDisplay

        path = Path(argument).expanduser()
        return FileDisplay(
            path.with_stem(f"{path.stem}.{part + 1}") if part else path, size_px, rate_hz
        )
    display: Display = load(DISPLAYS, name)(argument, size_px, title, rate_hz)
    return display
