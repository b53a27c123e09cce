"""The value of `--display`: parsed, checked and opened; and the monitors that SDL lists, with the
conditions under which the loop's delay was measured with one of them.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import attrs

from lfpipe.config import Camera, Config
from lfpipe.config.modes import Nothing, Plugin, Target, VideoFile, Window
from lfpipe.errors import UserError
from lfpipe.host.machine import has_desktop
from lfpipe.plugins import DISPLAYS, load, make, plugins
from lfpipe.render.display import window_system
from lfpipe.render.display.display import Display, NoDisplay
from lfpipe.render.display.window_system import pygame

if TYPE_CHECKING:
    from lfpipe.render.display.window import OverlayView


# of the monitor for a first window: of its width, and at most of its height, since panels and title
# bars take some
WIDTH_SHARE = 2 / 3
HEIGHT_SHARE = 0.85
INCH_MM = 25.4  # by definition
# widths in EDIDs that know only an aspect: 160 x 90 mm, 16 x 10 mm, 1600 x 900 mm, ...
ASPECTS_MM = (16.0, 160.0, 1600.0)
NOMINAL_HZ = 60.0  # if a monitor does not report its rate
SQUARE = 0.1  # pixels further from square than this: the reported size is invented
PITCHES_MM = 0.05, 1.5  # of a telephone, and of a wall of LEDs


@attrs.frozen(kw_only=True)
class Monitor:
    """A monitor as its driver describes it."""

    number: int
    name: str
    x: int
    y: int
    width: int
    height: int
    """(x, y, width, height) is its area on the desktop, in the units of window positions."""
    pixel_mm: float | None
    """The pitch of its physical pixels, None if it reports no size or an impossible one."""
    rate_hz: float = NOMINAL_HZ
    """The refresh rate that it claims."""

    def window_for(self, size_px: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the first window for pictures of that size."""
        scale = min(WIDTH_SHARE * self.width / size_px[0], HEIGHT_SHARE * self.height / size_px[1])
        return max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))

    def __str__(self) -> str:
        size = f", {self.pixel_mm:.3f} mm a pixel" if self.pixel_mm else ""
        return f"{self.number} {self.name} {self.width}x{self.height}+{self.x}+{self.y}{size}"


def pixel_mm(dots_per_inch: tuple[float, float], width_px: int) -> float | None:
    """The pitch from the size that SDL reports, (horizontal, vertical); None if that cannot be the
    size of a monitor.
    """
    across, down = dots_per_inch
    low_mm, high_mm = PITCHES_MM
    if min(across, down) <= 0 or abs(across / down - 1) > SQUARE:
        return None
    width_mm = width_px * INCH_MM / across
    if any(abs(width_mm - aspect_mm) < 1 for aspect_mm in ASPECTS_MM):
        return None
    return width_mm / width_px if low_mm <= width_mm / width_px <= high_mm else None


def monitors() -> list[Monitor]:
    """All monitors, by number. pygame.display must be initialised."""
    facts = zip(
        pygame.display.get_desktop_sizes(),
        pygame.display.get_desktop_refresh_rates(),
        strict=True,
    )
    connected = []
    for number, ((width_px, _), rate_hz) in enumerate(facts):
        name, (x, y, width, height), dots_per_inch = window_system.monitor_facts(number)
        connected.append(
            Monitor(
                number=number,
                name=name,
                x=x,
                y=y,
                width=width,
                height=height,
                pixel_mm=pixel_mm(dots_per_inch, width_px),
                rate_hz=float(rate_hz or NOMINAL_HZ),
            )
        )
    return connected


def find_monitor(asked: str, offered: list[Monitor]) -> Monitor:
    """The monitor with that number or name, or the only one whose name contains it.

    Raises UserError, which lists them.
    """
    exact = [monitor for monitor in offered if asked in (str(monitor.number), monitor.name)]
    similar = [monitor for monitor in offered if asked.lower() in monitor.name.lower()]
    for matches in (exact, similar):
        if len(matches) == 1:
            return matches[0]
    what = "several monitors are called that" if similar else "no such monitor"
    raise UserError(
        f"screen.monitor {asked!r}: {what}",
        "use the number or part of the name of one of: " + "; ".join(map(str, offered)),
    )


def detect_monitors() -> tuple[str, list[Monitor]]:
    """SDL's driver and the monitors, without a window. Raises pygame.error if SDL cannot start."""
    try:
        return window_system.start(), monitors()
    finally:
        pygame.display.quit()


def device_latency_conditions(camera: str, asked: Camera, monitor: Monitor) -> str:
    """What a device latency holds for. camera: the driver's name. asked: its settings."""
    rate = "auto rate" if isinstance(asked.rate_hz, str) else f"{asked.rate_hz:g} Hz"
    mode = f"{asked.width_px}x{asked.height_px} {asked.format} {rate}"
    texts = (camera, mode, monitor.name, f"{monitor.rate_hz:g} Hz")
    return "; ".join(text.replace(";", ",") for text in texts)


def device_latency_doubt(config: Config, camera: str, monitors: list[Monitor]) -> str:
    """The reason to distrust render.device_latency_ms now; "" if there is none. camera: name of
    the camera in use. monitors: all connected ones; without screen.monitor the window may be on
    any of them.
    """
    then = config.render.device_latency_measured.partition("; ")[2]  # after its date
    if not then:
        return "it was set by hand, not measured" if config.render.device_latency_ms else ""
    asked = str(config.screen.monitor).lower()
    here = [
        monitor
        for monitor in monitors
        if asked in ("", str(monitor.number)) or asked in monitor.name.lower()
    ]
    now = [device_latency_conditions(camera, config.camera, monitor) for monitor in here]
    if then in now:
        return ""
    return f"measured with {then}; now it is {' or '.join(now) or 'another monitor'}".replace(
        "; ", ", "
    )


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
                from lfpipe.render.display.open_display import detect_monitors, find_monitor

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
    make_view: Callable[[], OverlayView],
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
