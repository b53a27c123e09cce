"""Parses, checks and opens the value of `--display`."""

import contextlib
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from lfpipe.config.session_options import Nothing, Plugin, Target, VideoFile, Window
from lfpipe.errors import UserError
from lfpipe.host.worker import has_desktop
from lfpipe.plugins import DISPLAYS, load, make, plugins
from lfpipe.render.display.display import Display, NoDisplay

if TYPE_CHECKING:
    from lfpipe.render.ui.overlay_view import OverlayView

HINT = "h shows the keys, g tests your glasses"
FORMS = "window, fullscreen, none or file:OUT.mkv (or .mp4)"


def _sockets() -> Iterator[tuple[socket.AddressFamily, str | tuple[str, int]]]:
    """Addresses of the display servers that the environment names."""
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


def parse_display(text: str) -> Target:
    """The display named by `--display`. Raises UserError for an unknown one."""
    name, _, argument = text.partition(":")
    match name:
        case "window" | "fullscreen" if text == name:
            return Window(fullscreen=name == "fullscreen")
        case "none" if text == name:
            return Nothing()
        case "file" if argument:
            return VideoFile(Path(argument).expanduser())
        case _ if name in plugins(DISPLAYS):
            return Plugin(name, argument)
        case _:
            plugged = "".join(f", or {name}:ARGUMENT" for name in plugins(DISPLAYS))
            raise UserError(f"--display {text!r}: not a display", f"use one of {FORMS}{plugged}")


def check_display(target: Target, monitor: str = "") -> None:
    """Raises UserError if target needs a missing screen or monitor, is an unwritable file, or
    belongs to a broken package. monitor: `screen.monitor`.
    """
    match target:
        case Window():
            if not has_display():
                named = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
                why = (
                    f"{named} does not answer"
                    if named
                    else "neither WAYLAND_DISPLAY nor DISPLAY is set"
                )
                raise UserError(
                    f"--display {target}: no screen here ({why})",
                    "use --display none or --display file:OUT.mkv, or run on a desktop",
                )
            if monitor:
                from lfpipe.render.display.monitors import detect_monitors, find_monitor

                find_monitor(monitor, detect_monitors()[1])
        case VideoFile(path):
            from lfpipe.render.display.file_display import check_file

            check_file(path)
        case Plugin(name):
            load(DISPLAYS, name)


def open_display(
    target: Target,
    size_px: tuple[int, int],
    title: str,
    rate_hz: float,
    make_view: "Callable[[], OverlayView]",
    monitor: str = "",
    restarts: int = 0,
) -> Display:
    """Opens a display that `check_display` has accepted.

    size_px: (width, height) of the pictures; rate_hz: their highest rate, and the rate of a video;
    make_view: makes what draws the overlay in a window; monitor: `screen.monitor`; restarts: how
    often the process that writes a video was restarted, which makes the next file. Raises
    UserError if it cannot be opened.
    """
    match target:
        case Window(fullscreen=fullscreen, lock_code=code):
            from lfpipe.render.display.window import ScreenWindow

            title = title if code else f"{title} ({HINT})"
            return ScreenWindow(size_px, title, make_view(), fullscreen, monitor, code)
        case VideoFile(path):
            from lfpipe.render.display.file_display import FileDisplay

            if restarts:
                path = path.with_stem(f"{path.stem}.{restarts + 1}")
            return FileDisplay(path, size_px, rate_hz)
        case Plugin(name, argument):
            display: Display = make(DISPLAYS, name, argument, size_px, title, rate_hz)
            return display
        case Nothing():
            return NoDisplay()
