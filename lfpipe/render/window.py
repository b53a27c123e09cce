"""The window on the screen: SDL's surface written in place, no picture copied that need not be."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.render import sdl
from lfpipe.render.display import KEYS
from lfpipe.render.monitors import Monitor, find_monitor, monitor_of, monitors
from lfpipe.render.overlay import panel
from lfpipe.render.scaling import fit_area, scale_into
from lfpipe.render.sdl import pygame

SMALLEST_PX, SMALLEST_SHARE = 640, 1 / 3  # of the width of the monitor; small light fields are shown larger in the first window
HINT_S = 6.0
SCREEN_SHARE = 0.85  # at most, of the monitor
TEXT_PX, TEXT_SHARE = 22, 1 / 50  # of the monitor's height: on a fine one, text of TEXT_PX is too small
NAMES = {key: name for key, (name, _) in KEYS.items()} | {"=": "alpha+", "\x1b": "quit"}
RED_MASKS = {0xFF0000: cv2.COLOR_BGR2BGRA, 0xFF: cv2.COLOR_BGR2RGBA}


class Window:
    """A resizable window or the full screen. `show` draws at once; there is no waiting for the screen's own refresh.

    Its pixels are the screen's own: where a desktop scales windows, SDL asks it not to scale this one.
    """

    def __init__(self, size_px: tuple[int, int], title: str, fullscreen: bool = False, monitor: str = "", hint: str = "") -> None:
        """size_px: (width, height) of the pictures. monitor: a number or name, as `monitors.find_monitor` takes it; empty:
        where the desktop puts windows. hint: a line over the picture for HINT_S, or until a key is pressed.
        Raises UserError where no window can be opened, or there is no such monitor."""
        self._title, self._fullscreen, self._wanted = title, fullscreen, monitor
        try:
            sdl.start()
            self._monitors = monitors()
            on = find_monitor(monitor, self._monitors) if monitor else self._monitors[0]
            largest = min(SCREEN_SHARE * on.width / size_px[0], SCREEN_SHARE * on.height / size_px[1])
            scale = min(max(1.0, max(SMALLEST_PX, SMALLEST_SHARE * on.width) / max(size_px)), largest)
            self._windowed = max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))
            self._at: tuple[int, int] | None = None
            if monitor:
                self._at = on.x + (on.width - self._windowed[0]) // 2, on.y + (on.height - self._windowed[1]) // 2
            self._window = self._opened(on)
        except UserError:
            pygame.display.quit()
            raise
        except pygame.error as error:
            raise UserError(f"no window can be opened: {error}", "use --display none or --display file:OUT.mkv") from None
        pygame.font.init()
        self._on = on
        self._picture: NDArray[np.uint8] | None = None
        self._four: NDArray[np.uint8] = np.empty((0, 0, 4), np.uint8)
        self._shown_px = fit_area(size_px, self._window.get_surface().get_size())[2]
        self._lines: list[str] = []
        self._inset: NDArray[np.uint8] | None = None
        self._help = False
        self._hint, self._hint_end_ns = hint, time.monotonic_ns() + int(HINT_S * 1e9)
        self._panel: pygame.Surface | None = None
        self._make_panel()

    def _opened(self, on: Monitor) -> pygame.Window:
        if self._fullscreen:
            whole, place = (on.width, on.height), (on.x, on.y)
            window = pygame.Window(self._title, whole, place, fullscreen_desktop=True, allow_high_dpi=True)
        else:
            at = self._at or pygame.WINDOWPOS_UNDEFINED
            window = pygame.Window(self._title, self._windowed, at, resizable=True, allow_high_dpi=True)
        pygame.mouse.set_visible(not self._fullscreen)
        surface = window.get_surface()
        if surface.get_bytesize() != 4 or surface.get_masks()[0] not in RED_MASKS:
            raise UserError(f"the screen has {surface.get_bitsize()} bits a pixel", "a screen of 24 or 32 bits a pixel is needed")
        return window

    def _toggle(self) -> None:
        """Full screen on the chosen monitor, or else on the one where the window is; back to where the window was.

        The window is opened again: without a window manager SDL neither moves nor shrinks the one that is there.
        """
        if not self._fullscreen:
            self._windowed, self._at = self._window.size, self._window.position
        self._monitors = monitors()  # one may have come or gone
        self._on = self._here()
        if self._wanted:
            with contextlib.suppress(UserError):  # the chosen one was unplugged
                self._on = find_monitor(self._wanted, self._monitors)
        self._fullscreen = not self._fullscreen
        self._window.destroy()
        self._window = self._opened(self._on)

    def _here(self) -> Monitor:
        """The monitor on which the window is."""
        number = monitor_of(self._window)
        return next((each for each in self._monitors if each.number == number), self._monitors[0])

    def width_mm(self) -> float | None:
        """See `Display.width_mm`."""
        return self._shown_px * self._on.pixel_mm if self._on.pixel_mm and self._shown_px else None

    def to_picture(self, position: tuple[int, int]) -> tuple[float, float]:
        """Where in the picture a click at position of the window is, in px of the picture."""
        if self._picture is None:
            return 0.0, 0.0
        rows, cols = self._picture.shape[:2]
        surface_px, window = self._window.get_surface().get_size(), self._window.size
        x, y, width, height = fit_area((cols, rows), surface_px)
        x_px, y_px = position[0] * surface_px[0] / window[0], position[1] * surface_px[1] / window[1]
        return (x_px - x) * cols / width, (y_px - y) * rows / height

    def show(self, picture: NDArray[np.uint8]) -> int:
        """See `Display.show`; presented is when the window system has taken the picture."""
        self._picture = picture
        self._draw()
        return time.monotonic_ns()

    def _draw(self) -> None:
        if self._picture is None:
            return
        surface = self._window.get_surface()
        self._paint(surface, self._picture)
        if self._panel is not None:
            surface.blit(self._panel, (12, 12))
        self._window.flip()

    def _paint(self, surface: pygame.Surface, picture: NDArray[np.uint8]) -> None:
        # The views of the surface's memory end with this call: as long as one lives the surface is locked.
        width, height = surface.get_size()
        memory: Any = surface.get_buffer()  # a buffer, but not to the type checker
        pixels = np.frombuffer(memory, np.uint8).reshape(height, surface.get_pitch() // 4, 4)[:, :width]
        x, y, w, h = fit_area((picture.shape[1], picture.shape[0]), (width, height))
        self._shown_px = w
        code = RED_MASKS[surface.get_masks()[0]]
        pixels[:y], pixels[y + h :], pixels[y : y + h, :x], pixels[y : y + h, x + w :] = 0, 0, 0, 0
        target = pixels[y : y + h, x : x + w]
        if picture.shape[:2] == (h, w):
            cv2.cvtColor(picture, code, dst=target)
            return
        # Converted before it grows: the scaler then writes straight into the surface.
        if self._four.shape[:2] != picture.shape[:2]:
            self._four = np.empty((*picture.shape[:2], 4), np.uint8)
        cv2.cvtColor(picture, code, dst=self._four)
        scale_into(self._four, target)

    def events(self) -> list[str]:
        """See `Display.events`. Carries out full screen and help itself, and draws again what was covered or resized."""
        pressed, again, resized, keyed = [], False, False, False
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                pressed.append("quit")
            elif event.type == pygame.KEYDOWN:
                keyed = True
                if name := NAMES.get(event.unicode.lower()):
                    pressed.append(name)
            elif event.type == pygame.WINDOWEXPOSED:
                again = True
            elif event.type in (pygame.WINDOWSIZECHANGED, pygame.WINDOWDISPLAYCHANGED):
                resized = True
        for name in pressed:
            if name == "fullscreen":
                self._toggle()
                resized = True
            elif name == "help":
                self._help = not self._help
                self._make_panel()
                again = True
        if self._hint and (keyed or time.monotonic_ns() > self._hint_end_ns):
            self._hint, again = "", True
            self._make_panel()
        if resized:
            self._on = self._here()
            self._make_panel()
        if again or resized:
            self._draw()
        return pressed

    def notices(self) -> list[str]:
        return []

    def overlay(self, lines: list[str], inset: NDArray[np.uint8] | None = None) -> None:
        """See `Display.overlay`."""
        if lines != self._lines or inset is not self._inset:
            self._lines, self._inset = list(lines), inset if lines else None
            self._make_panel()
            self._draw()

    def _make_panel(self) -> None:
        lines = [*self._lines, *([f"{key}\t{text}" for key, (_, text) in KEYS.items()] if self._help else [])]
        if self._hint and not lines:
            lines = [self._hint]
        if not lines:
            self._panel = None
            return
        surface = self._window.get_surface()
        scaled = surface.get_size()[0] / self._window.size[0]
        text_px = round(max(TEXT_PX, TEXT_SHARE * self._on.height) * scaled)
        self._panel = panel(lines, self._inset, text_px, (surface.get_width() - 24, surface.get_height() - 24))

    def close(self) -> None:
        self._window.destroy()
        pygame.display.quit()
