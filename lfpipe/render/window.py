"""The window on the screen: SDL's surface written in place, no picture copied that need not be."""

from __future__ import annotations

import os
import time
import warnings
from pathlib import Path
from typing import Any

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
os.environ.setdefault("SDL_NO_SIGNAL_HANDLERS", "1")  # the process has its own
if not any(Path("/dev/dri").glob("renderD*")):
    # SDL gives its window surface through OpenGL; without a GPU that is a software renderer and ten times the cost.
    os.environ.setdefault("SDL_FRAMEBUFFER_ACCELERATION", "0")

import cv2
import numpy as np
import pygame
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.render.display import KEYS
from lfpipe.render.fit import fit_area, scale_into

SMALLEST_PX = 640  # small light fields are shown larger; the longer side of the first window
SCREEN_SHARE = 0.85  # of the screen at the most
TEXT_PX = 22
NAMES = {key: name for key, (name, _) in KEYS.items()} | {"=": "alpha+", "\x1b": "quit"}
UNSEEN = ("dummy", "offscreen")  # drivers that show nothing, for who asks for them
RED_MASKS = {0xFF0000: cv2.COLOR_BGR2BGRA, 0xFF: cv2.COLOR_BGR2RGBA}


class Window:
    """A resizable window or the full screen. `show` draws at once; there is no waiting for the screen's own refresh."""

    def __init__(self, size_px: tuple[int, int], title: str, fullscreen: bool = False) -> None:
        """size_px: (width, height) of the pictures. Raises UserError where no window can be opened."""
        try:
            pygame.display.init()
            desktop = pygame.display.get_desktop_sizes()[0]
            largest = min(SCREEN_SHARE * desktop[0] / size_px[0], SCREEN_SHARE * desktop[1] / size_px[1])
            scale = min(max(1.0, SMALLEST_PX / max(size_px)), largest)
            self._windowed = round(size_px[0] * scale), round(size_px[1] * scale)
            self._title, self._fullscreen = title, fullscreen
            self._set_mode()
        except pygame.error as error:
            raise UserError(f"no window can be opened: {error}", "use --display none or --display file:OUT.mkv") from None
        pygame.font.init()
        self._font = pygame.font.Font(None, TEXT_PX)
        self._picture: NDArray[np.uint8] | None = None
        self._four: NDArray[np.uint8] = np.empty((0, 0, 4), np.uint8)
        self._lines: list[str] = []
        self._inset: NDArray[np.uint8] | None = None
        self._help = False
        self._panel: pygame.Surface | None = None

    def _set_mode(self) -> None:
        """Opens the window anew: without a window manager SDL neither moves nor shrinks the one that is there."""
        pygame.display.quit()
        pygame.display.init()
        if (name := pygame.display.get_driver()) in UNSEEN and os.environ.get("SDL_VIDEODRIVER") != name:
            raise pygame.error(f"no screen answers, SDL fell back to its driver {name!r}")
        pygame.display.set_caption(f"{self._title} (h shows the keys)")
        if self._fullscreen:
            surface = pygame.display.set_mode((0, 0), pygame.FULLSCREEN)
        else:
            with warnings.catch_warnings():  # a window manager may give another size; `show` takes whatever there is
                warnings.simplefilter("ignore", RuntimeWarning)
                surface = pygame.display.set_mode(self._windowed, pygame.RESIZABLE)
        pygame.mouse.set_visible(not self._fullscreen)
        if surface.get_bytesize() != 4 or surface.get_masks()[0] not in RED_MASKS:
            raise UserError(f"the screen has {surface.get_bitsize()} bits a pixel", "a screen of 24 or 32 bits a pixel is needed")

    def show(self, picture: NDArray[np.uint8]) -> int:
        """See `Display.show`; presented is when the window system has taken the picture."""
        self._picture = picture
        self._draw()
        return time.monotonic_ns()

    def _draw(self) -> None:
        surface = pygame.display.get_surface()
        if self._picture is None or surface is None:
            return
        self._paint(surface, self._picture)
        if self._panel is not None:
            surface.blit(self._panel, (12, 12))
        pygame.display.flip()

    def _paint(self, surface: pygame.Surface, picture: NDArray[np.uint8]) -> None:
        # The views of the surface's memory end with this call: as long as one lives the surface is locked.
        width, height = surface.get_size()
        memory: Any = surface.get_buffer()  # a buffer, but not to the type checker
        pixels = np.frombuffer(memory, np.uint8).reshape(height, surface.get_pitch() // 4, 4)[:, :width]
        x, y, w, h = fit_area((picture.shape[1], picture.shape[0]), (width, height))
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
        pressed, again = [], False
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                pressed.append("quit")
            elif event.type == pygame.KEYDOWN and (name := NAMES.get(event.unicode.lower())):
                pressed.append(name)
            elif event.type in (pygame.WINDOWEXPOSED, pygame.WINDOWSIZECHANGED):
                again = True
            elif event.type == pygame.VIDEORESIZE and not self._fullscreen:
                self._windowed = event.w, event.h
        for name in pressed:
            if name == "fullscreen":
                self._fullscreen = not self._fullscreen
                self._set_mode()
                again = True
            elif name == "help":
                self._help = not self._help
                self._make_panel()
                again = True
        if again:
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
        lines = [*self._lines, *([f"{key}   {text}" for key, (_, text) in KEYS.items()] if self._help else [])]
        if not lines:
            self._panel = None
            return
        # White on black: the same for both eyes, so the text stands in the plane of the screen behind any glasses.
        texts = [self._font.render(line, True, (255, 255, 255)) for line in lines]
        step, small = self._font.get_linesize(), None
        width, height = max(text.get_width() for text in texts) + 16, step * len(texts) + 12
        if self._inset is not None:
            size = self._inset.shape[1], self._inset.shape[0]
            small = pygame.image.frombuffer(self._inset[:, :, ::-1].tobytes(), size, "RGB")
            width, height = max(width, size[0] + 16), height + size[1] + 8
        panel = pygame.Surface((width, height), pygame.SRCALPHA)
        panel.fill((0, 0, 0, 160))
        for index, text in enumerate(texts):
            panel.blit(text, (8, 6 + index * step))
        if small is not None:
            panel.blit(small, (8, height - small.get_height() - 8))
        self._panel = panel

    def close(self) -> None:
        pygame.display.quit()


def driver() -> tuple[str, str]:
    """SDL's video driver and version, without opening a window. Raises pygame.error where SDL cannot start."""
    pygame.display.init()
    try:
        return pygame.display.get_driver(), ".".join(str(part) for part in pygame.version.SDL)
    finally:
        pygame.display.quit()
