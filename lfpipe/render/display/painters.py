"""Painters put a picture into a window: SDL's renderer scales it and swaps in step with the screen;
the processor fills the window's surface. Of both:

    size_px   (width, height) of the window in the screen's own pixels
    paint     draws uint8 (height, width, 3) BGR, scaled to fit, and panels over it; shows nothing
    swap      hands the drawn picture to the window system
"""

import contextlib
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.codecs import fit_area
from lfpipe.render.display.panels import Panel
from lfpipe.render.display.window_system import pygame, uses_renderer, video
from lfpipe.render.synthesis.anaglyph import scale_into

RED_MASKS = {0xFF0000: cv2.COLOR_BGR2BGRA, 0xFF: cv2.COLOR_BGR2RGBA}


class SurfacePainter:
    """Writes into the window's surface with as few copies as possible."""

    def __init__(self, window: pygame.Window) -> None:
        """Raises UserError if the screen's pixels do not have 32 bits."""
        self._window = window
        surface = window.get_surface()
        if surface.get_bytesize() != 4 or surface.get_masks()[0] not in RED_MASKS:
            raise UserError(
                f"the screen has {surface.get_bitsize()} bits per pixel",
                "use a screen with 24 or 32 bits per pixel",
            )
        self._code = RED_MASKS[surface.get_masks()[0]]
        self._four: NDArray[np.uint8] | None = None

    def size_px(self) -> tuple[int, int]:
        return self._window.get_surface().get_size()

    def paint(self, picture: NDArray[np.uint8], panels: Sequence[Panel]) -> None:
        surface = self._window.get_surface()
        self._write(surface, picture)
        surface.blits([(panel.surface, panel.at) for panel in panels])

    def swap(self) -> None:
        self._window.flip()

    def _write(self, surface: pygame.Surface, picture: NDArray[np.uint8]) -> None:
        # the views of the surface's memory end with this call:
        # the surface is locked as long as one lives
        width, height = surface.get_size()
        memory: Any = surface.get_buffer()  # a buffer, though the type checker disagrees
        pixels = np.frombuffer(memory, np.uint8).reshape(height, surface.get_pitch() // 4, 4)[
            :, :width
        ]
        x, y, w, h = fit_area((picture.shape[1], picture.shape[0]), (width, height))
        pixels[:y], pixels[y + h :], pixels[y : y + h, :x], pixels[y : y + h, x + w :] = 0, 0, 0, 0
        target = pixels[y : y + h, x : x + w]
        if picture.shape[:2] == (h, w):
            cv2.cvtColor(picture, self._code, dst=target)
        else:  # converted before scaling up: the scaler then writes straight into the surface
            self._four = np.asarray(cv2.cvtColor(picture, self._code, dst=self._four), np.uint8)
            scale_into(self._four, target)


class RendererPainter:
    """Uploads pictures of their own size to a streaming texture; SDL's renderer scales them and
    swaps.
    """

    def __init__(self, window: pygame.Window, wait: bool) -> None:
        """wait: `swap` waits for the screen. Raises pygame.error without an accelerated
        renderer.
        """
        self._renderer = video.Renderer(window, -1, 1, wait)
        self._texture: video.Texture | None = None
        self._four: NDArray[np.uint8] = np.empty((0, 0, 4), np.uint8)
        self._textures: dict[Panel, video.Texture] = {}

    def size_px(self) -> tuple[int, int]:
        viewport = self._renderer.get_viewport()
        return viewport.width, viewport.height

    def paint(self, picture: NDArray[np.uint8], panels: Sequence[Panel]) -> None:
        rows, cols = picture.shape[:2]
        if self._texture is None or self._four.shape[:2] != (rows, cols):
            self._four = np.empty((rows, cols, 4), np.uint8)
            self._texture = video.Texture(
                self._renderer, (cols, rows), streaming=True, scale_quality=1
            )
        cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA, dst=self._four)
        self._texture.update(pygame.image.frombuffer(self._four.data, (cols, rows), "BGRA"))
        self._renderer.clear()
        self._texture.draw(dstrect=fit_area((cols, rows), self.size_px()))
        self._textures = {
            panel: (
                self._textures.get(panel)
                or video.Texture.from_surface(self._renderer, panel.surface)
            )
            for panel in panels
        }
        for panel, texture in self._textures.items():
            texture.draw(dstrect=(*panel.at, *panel.surface.get_size()))

    def swap(self) -> None:
        self._renderer.present()


def open_painter(window: pygame.Window, driver: str) -> SurfacePainter | RendererPainter:
    """The renderer where it is cheaper and available, with a GPU or on Wayland, else the surface;
    the renderer, too, where the screen's pixels are none that SDL has surfaces for, as on X with 30
    bits. Raises UserError as `SurfacePainter` does, pygame.error where neither is available.
    """
    if not uses_renderer(driver):
        with contextlib.suppress(pygame.error):
            return SurfacePainter(window)
    # A Wayland compositor takes the newest complete picture at each vblank: waiting for the
    # previous one would only make the next one older.
    with contextlib.suppress(pygame.error):
        return RendererPainter(window, wait=driver != "wayland")
    return SurfacePainter(window)
