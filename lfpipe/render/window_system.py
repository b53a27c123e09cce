"""Parts of SDL that pygame does not expose: monitors' names, positions and rates, and a window's handles, which give access to
blanks."""

import ctypes
import functools

from lfpipe.host.presentation import Presentation
from lfpipe.host.wayland_presentation import WaylandPresentation
from lfpipe.host.x_presentation import XPresentation
from lfpipe.render.sdl import pygame

_X11, _WAYLAND = 2, 6  # SDL_SYSWM_TYPE
NOMINAL_HZ = 60.0  # if a screen does not report its rate


class _Handles(ctypes.Structure):
    """SDL_SysWMinfo: the first two handles are Display and Window of X11, or wl_display and wl_surface."""

    _fields_ = (("version", ctypes.c_uint8 * 3), ("system", ctypes.c_int), ("handles", ctypes.c_void_p * 8))


class _Mode(ctypes.Structure):
    """SDL_DisplayMode."""

    _fields_ = (
        ("format", ctypes.c_uint32),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("rate_hz", ctypes.c_int),
        ("driver", ctypes.c_void_p),
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


def monitor_facts(monitor: int) -> tuple[str, tuple[int, int, int, int], tuple[float, float] | None]:
    """(name, (x, y, width, height) on the desktop, (horizontal, vertical) dots per inch or None if unknown) of a monitor."""
    place, dots = (ctypes.c_int * 4)(), [ctypes.c_float() for _ in range(3)]
    sdl_library().SDL_GetDisplayBounds(monitor, place)
    known = sdl_library().SDL_GetDisplayDPI(monitor, *map(ctypes.byref, dots)) == 0
    name = (sdl_library().SDL_GetDisplayName(monitor) or b"").decode(errors="replace")
    x, y, width, height = place
    return name, (x, y, width, height), (dots[1].value, dots[2].value) if known else None


def monitor_number(window: pygame.Window) -> int:
    """The number of the monitor that holds the window's centre."""
    return max(0, int(sdl_library().SDL_GetWindowDisplayIndex(sdl_library().SDL_GetWindowFromID(window.id))))


def nominal_hz(monitor: int) -> float:
    """The refresh rate that monitor number `monitor` claims, in whole Hz."""
    mode = _Mode()
    known = sdl_library().SDL_GetCurrentDisplayMode(monitor, ctypes.byref(mode)) == 0
    return float(mode.rate_hz) if known and mode.rate_hz > 0 else NOMINAL_HZ


def open_presentation(window: pygame.Window) -> Presentation | None:
    """The source of reports of this window's blanks, or None. Call after creating the painter: it may replace the window."""
    library, info = sdl_library(), _Handles()
    info.version[:] = pygame.version.SDL
    if not library.SDL_GetWindowWMInfo(library.SDL_GetWindowFromID(window.id), ctypes.byref(info)):
        return None
    first, second = int(info.handles[0] or 0), int(info.handles[1] or 0)
    try:
        if info.system == _WAYLAND and first and second:
            return WaylandPresentation(first, second)
        if info.system == _X11 and second:
            return XPresentation(second)
    except OSError:
        pass
    return None
