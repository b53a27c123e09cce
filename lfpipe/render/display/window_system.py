"""SDL with this program's settings, and features that pygame lacks: the vblanks of a window, and
monitors, with the conditions under which the loop's delay was measured with one of them.

Import pygame from here: SDL reads its environment when it starts.
"""

import contextlib
import ctypes
import functools
import os
from pathlib import Path
from typing import TYPE_CHECKING

import attrs

from lfpipe.errors import UserError
from lfpipe.host.presentation import XPresentation
from lfpipe.host.worker import has_gpu

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
os.environ.setdefault("SDL_NO_SIGNAL_HANDLERS", "1")  # the process has its own handlers
os.environ.setdefault("SDL_VIDEO_X11_WMCLASS", "lfpipe")  # desktops group and name windows by it

import pygame as pygame
from pygame._sdl2 import video as video

if TYPE_CHECKING:  # the window of splash.py is there before settings are
    from lfpipe.config import Camera, Config

ICON_PX = 64  # desktops scale it down
FONT = Path(__file__).parent / "fonts" / "DejaVuSans.ttf"
BOLD = FONT.with_stem("DejaVuSans-Bold")  # the letters of European languages only
FONT_SHARE = 0.75  # size of letters, as fonts count it, over the height of their line
UNSEEN = ("dummy", "offscreen")  # drivers without a screen, for tests


def start() -> str:
    """Starts SDL's display part; returns the name of its driver. Raises pygame.error if no screen
    answers.

    SDL provides a window's surface through OpenGL; without a GPU that is a software renderer at ten
    times the cost. X can do without; Wayland cannot.
    """
    pygame.display.init()
    driver = pygame.display.get_driver()
    if driver in UNSEEN and os.environ.get("SDL_VIDEODRIVER") != driver:
        raise pygame.error(f"no screen answers, SDL fell back to its driver {driver!r}")
    if driver == "x11" and not has_gpu():
        os.environ.setdefault("SDL_FRAMEBUFFER_ACCELERATION", "0")
    return driver


def uses_renderer(driver: str) -> bool:
    """Whether a window draws through SDL's renderer: with a GPU, and on Wayland, which has no
    surface of its own.
    """
    return driver == "wayland" or (driver == "x11" and has_gpu())


def drawn_by(driver: str) -> str:
    """The way in which pictures are drawn, for people."""
    if not uses_renderer(driver):
        return "drawn by the CPU into a surface in shared memory" + " (no GPU)" * (not has_gpu())
    by = "by the GPU" if has_gpu() else "OpenGL in software (no GPU)"
    return f"renderer in step with the screen, {by}"


def new_events() -> list[pygame.Event]:
    """The events since the last call.

    pygame cannot decode every name of a dropped file: such a drop has no name.
    """
    try:
        return pygame.event.get()
    except (SystemError, UnicodeError):
        return [pygame.Event(pygame.DROPFILE, file="")]


def drawable(text: str) -> str:
    """text that a font can draw: a file name may hold bytes that are no character."""
    return text.replace("\0", "").encode(errors="replace").decode()


@functools.lru_cache(32)
def font(size_px: int, bold: bool = False) -> pygame.font.Font:
    """DejaVu Sans, which is made for screens: its letters stay evenly spaced when they are small.

    size_px: height of a line, about.
    """
    return pygame.font.Font(BOLD if bold else FONT, round(FONT_SHARE * size_px))


def written(
    text: str, size_px: int, colour: tuple[int, ...], bold: bool = False, wrap_px: int = 0
) -> pygame.Surface:
    """Text in letters of that size, in lines of at most wrap_px if that is not 0."""
    letters = font(size_px, bold and max(text, default="") < "\u0180")
    return letters.render(drawable(text), True, colour, None, wrap_px)


def icon() -> pygame.Surface:
    """Two overlapping discs, red and cyan: one object as both eyes see it."""
    icon = pygame.Surface((ICON_PX, ICON_PX), pygame.SRCALPHA)
    for x, colour in ((0.38, (255, 40, 40)), (0.62, (0, 215, 215))):
        disc = pygame.Surface((ICON_PX, ICON_PX), pygame.SRCALPHA)
        pygame.draw.circle(
            disc, (*colour, 255), (round(x * ICON_PX), ICON_PX // 2), round(0.36 * ICON_PX)
        )
        icon.blit(disc, (0, 0), special_flags=pygame.BLEND_RGBA_ADD)
    return icon


_X11, _WAYLAND = 2, 6  # SDL_SYSWM_TYPE


class _Handles(ctypes.Structure):
    """SDL_SysWMinfo: the first two handles are Display and Window of X11, or wl_display and
    wl_surface.
    """

    _fields_ = (
        ("version", ctypes.c_uint8 * 3),
        ("system", ctypes.c_int),
        ("handles", ctypes.c_void_p * 8),
    )


@functools.cache
def sdl_library() -> ctypes.CDLL:
    """The SDL library that pygame has loaded."""
    library = ctypes.CDLL(pygame.display.__file__)
    library.SDL_GetDisplayName.restype = ctypes.c_char_p
    library.SDL_GetWindowFromID.restype = ctypes.c_void_p
    library.SDL_GetWindowDisplayIndex.argtypes = [ctypes.c_void_p]
    library.SDL_GetWindowWMInfo.argtypes = [ctypes.c_void_p, ctypes.POINTER(_Handles)]
    return library


def monitor_number(window: pygame.Window) -> int:
    """The number of the monitor that holds the window's centre."""
    return max(
        0,
        int(sdl_library().SDL_GetWindowDisplayIndex(sdl_library().SDL_GetWindowFromID(window.id))),
    )


def _handles(window: pygame.Window) -> tuple[int, int, int]:
    """(system, display, window or surface) of a window; zeros if unknown."""
    library = sdl_library()
    info = _Handles()
    info.version[:] = pygame.version.SDL
    if not library.SDL_GetWindowWMInfo(library.SDL_GetWindowFromID(window.id), ctypes.byref(info)):
        return 0, 0, 0
    return int(info.system), int(info.handles[0] or 0), int(info.handles[1] or 0)


def connection_fds(window: pygame.Window) -> tuple[int, ...] | None:
    """The descriptor that can be read when the window has events; None if it is unknown."""
    system, display, _ = _handles(window)
    names = {
        _X11: ("libX11.so.6", "XConnectionNumber"),
        _WAYLAND: ("libwayland-client.so.0", "wl_display_get_fd"),
    }
    if system in names and display:
        library, name = names[system]
        with contextlib.suppress(OSError, AttributeError):
            function = getattr(ctypes.CDLL(library), name)
            function.argtypes = [ctypes.c_void_p]
            return (int(function(display)),)
    return None


def open_presentation(window: pygame.Window) -> XPresentation | None:
    """The source of reports of this window's vblanks; None where the window system has none that
    is used here.

    Call after creating the painter: it may replace the window.
    """
    system, _, handle = _handles(window)
    with contextlib.suppress(OSError):
        if system == _X11 and handle:
            return XPresentation(handle)
    return None


# of the monitor for a first window: of its width, and at most of its height, since panels and title
# bars take some
WIDTH_SHARE = 2 / 3
HEIGHT_SHARE = 0.85
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
    width_mm = width_px * 25.4 / across  # mm of an inch
    if any(abs(width_mm - aspect_mm) < 1 for aspect_mm in ASPECTS_MM):
        return None
    return width_mm / width_px if low_mm <= width_mm / width_px <= high_mm else None


def monitors() -> list[Monitor]:
    """All monitors, by number. pygame.display must be initialised."""
    sizes, rates = pygame.display.get_desktop_sizes(), pygame.display.get_desktop_refresh_rates()
    library, monitors = sdl_library(), list[Monitor]()
    for number, ((width_px, _), rate_hz) in enumerate(zip(sizes, rates, strict=True)):
        place = (ctypes.c_int * 4)()
        dots = [ctypes.c_float() for _ in range(3)]  # per inch: diagonally, across and down
        library.SDL_GetDisplayBounds(number, place)
        library.SDL_GetDisplayDPI(number, *map(ctypes.byref, dots))
        monitors.append(
            Monitor(
                number=number,
                name=(library.SDL_GetDisplayName(number) or b"").decode(errors="replace"),
                x=place[0],
                y=place[1],
                width=place[2],
                height=place[3],
                pixel_mm=pixel_mm((dots[1].value, dots[2].value), width_px),
                rate_hz=float(rate_hz or NOMINAL_HZ),
            )
        )
    return monitors


def find_monitor(wanted: str, offered: list[Monitor]) -> Monitor:
    """The monitor with that number or name, or the only one whose name contains it.

    Raises UserError, which lists them.
    """
    exact = [monitor for monitor in offered if wanted in (str(monitor.number), monitor.name)]
    similar = [monitor for monitor in offered if wanted.lower() in monitor.name.lower()]
    for matches in (exact, similar):
        if len(matches) == 1:
            return matches[0]
    what = "several monitors are called that" if similar else "no such monitor"
    raise UserError(
        f"screen.monitor {wanted!r}: {what}",
        "use the number or part of the name of one of: " + "; ".join(map(str, offered)),
    )


def detect_monitors() -> tuple[str, list[Monitor]]:
    """SDL's driver and the monitors, without a window. Raises pygame.error if SDL cannot start."""
    try:
        return start(), monitors()
    finally:
        pygame.display.quit()


def device_latency_conditions(camera: str, settings: "Camera", monitor: Monitor) -> str:
    """What a device latency holds for. camera: the driver's name."""
    rate = "auto rate" if isinstance(settings.rate_hz, str) else f"{settings.rate_hz:g} Hz"
    mode = f"{settings.width_px}x{settings.height_px} {settings.format} {rate}"
    texts = (camera, mode, monitor.name, f"{monitor.rate_hz:g} Hz")
    return "; ".join(text.replace(";", ",") for text in texts)


def device_latency_doubt(config: "Config", camera: str, monitors: list[Monitor]) -> str:
    """The reason to distrust render.device_latency_ms now; "" if there is none. camera: name of
    the camera in use. monitors: all connected ones; without screen.monitor the window may be on
    any of them.
    """
    then = config.render.device_latency_measured.partition("; ")[2]  # after its date
    if not then:
        return "it was set by hand, not measured" if config.render.device_latency_ms else ""
    wanted = str(config.screen.monitor).lower()
    now = [
        device_latency_conditions(camera, config.camera, monitor)
        for monitor in monitors
        if wanted in ("", str(monitor.number)) or wanted in monitor.name.lower()
    ]
    if then in now:
        return ""
    return f"measured with {then}; now it is {' or '.join(now) or 'another monitor'}".replace(
        "; ", ", "
    )
