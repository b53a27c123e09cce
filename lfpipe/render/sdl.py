"""SDL with this program's settings. Import pygame from here: SDL reads its environment when it starts."""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
os.environ.setdefault("SDL_NO_SIGNAL_HANDLERS", "1")  # the process has its own handlers
os.environ.setdefault("SDL_VIDEO_X11_WMCLASS", "lfpipe")  # desktops group and name windows by it

import pygame as pygame

from lfpipe.host.graphics import has_gpu

ICON_PX = 64
KEY_CODES = {pygame.K_F11: "fullscreen", pygame.K_ESCAPE: "escape", pygame.K_LEFT: "less", pygame.K_RIGHT: "more"}
KEY_CODES |= {pygame.K_PAGEDOWN: "next", pygame.K_PAGEUP: "previous", pygame.K_TAB: "choose"}
KEY_CODES |= {pygame.K_UP: "up", pygame.K_DOWN: "down", pygame.K_RETURN: "enter", pygame.K_KP_ENTER: "enter"}
UNSEEN = ("dummy", "offscreen")  # drivers without a screen, for tests


def start() -> str:
    """Starts SDL's display part; returns the name of its driver. Raises pygame.error if no screen answers.

    SDL provides a window's surface through OpenGL; without a GPU that is a software renderer at ten times the cost. X can do
    without; Wayland cannot.
    """
    pygame.display.init()
    driver = pygame.display.get_driver()
    if driver in UNSEEN and os.environ.get("SDL_VIDEODRIVER") != driver:
        raise pygame.error(f"no screen answers, SDL fell back to its driver {driver!r}")
    if driver == "x11" and not has_gpu():
        os.environ.setdefault("SDL_FRAMEBUFFER_ACCELERATION", "0")
    return driver


def uses_renderer(driver: str) -> bool:
    """Whether a window draws through SDL's renderer: with a GPU, and on Wayland, which has no surface of its own."""
    return driver == "wayland" or (driver == "x11" and has_gpu())


def drawn_by(driver: str) -> str:
    """The way in which pictures are drawn, for people."""
    if not uses_renderer(driver):
        return "drawn by the CPU into a surface in shared memory" + ("" if has_gpu() else " (no GPU)")
    return "renderer in step with the screen, " + ("by the GPU" if has_gpu() else "OpenGL in software (no GPU)")


def take_events() -> list[pygame.Event]:
    """The events since the last call. pygame cannot decode every name of a dropped file: such a drop has no name."""
    try:
        return pygame.event.get()
    except (SystemError, UnicodeError):
        return [pygame.Event(pygame.DROPFILE, file="")]


def drawable(text: str) -> str:
    """text that a font can draw: a file name may hold bytes that are no character."""
    return text.replace("\0", "").encode(errors="replace").decode()


def version() -> str:
    """The version of SDL."""
    return ".".join(str(part) for part in pygame.version.SDL)


def icon() -> pygame.Surface:
    """Two overlapping discs, red and cyan: one object as both eyes see it."""
    icon = pygame.Surface((ICON_PX, ICON_PX), pygame.SRCALPHA)
    for x, colour in ((0.38, (255, 40, 40)), (0.62, (0, 215, 215))):
        disc = pygame.Surface((ICON_PX, ICON_PX), pygame.SRCALPHA)
        pygame.draw.circle(disc, (*colour, 255), (round(x * ICON_PX), ICON_PX // 2), round(0.36 * ICON_PX))
        icon.blit(disc, (0, 0), special_flags=pygame.BLEND_RGBA_ADD)
    return icon
