"""The window of a calibration: live picture, lines of text, clicks in px of the picture, and two keys."""

import numpy as np
from numpy.typing import NDArray

from lfpipe.render.window import Window
from lfpipe.render.window_system import pygame


class CalibrationWindow:
    """`step` shows one picture and returns the person's input. Raises UserError if no window can be opened."""

    def __init__(self, size_px: tuple[int, int], title: str) -> None:
        self._window = Window((2 * size_px[0], 2 * size_px[1]), title)  # large, so that clicks fall between pixels too
        self.clicks: list[tuple[float, float]] = []
        self.enter = self.quit = False

    def step(self, picture: NDArray[np.uint8], lines: list[str]) -> None:
        """Shows uint8 (height, width, 3) BGR with lines of text over it."""
        self._window.overlay(lines)
        self._window.show(picture)
        for event in pygame.event.get():
            if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key in (pygame.K_ESCAPE, pygame.K_q)):
                self.quit = True
            elif event.type == pygame.KEYDOWN and event.key in (pygame.K_RETURN, pygame.K_SPACE, pygame.K_KP_ENTER):
                self.enter = True
            elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1:
                self.clicks.append(self._window.to_picture(event.pos))

    def close(self) -> None:
        self._window.close()
