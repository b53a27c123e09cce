"""What is written over the picture: lines of text and a small picture below them, white on black."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfpipe.render.sdl import pygame

LEAST_PX, MOST_SHARE = 13, 0.94  # of the text, and of the window that all of it may take


def _font(size_px: int) -> pygame.font.Font:
    return pygame.font.Font(None, size_px)


def panel(lines: list[str], inset: NDArray[np.uint8] | None, text_px: int, room_px: tuple[int, int]) -> pygame.Surface:
    """A translucent surface with lines of text_px, smaller where they would not fit into room_px (width, height).

    inset: uint8 (h, w, 3) BGR, left out where there is no room for it. White on black is the same for both eyes, so text
    stands in the plane of the screen behind any glasses.
    """
    font = _font(text_px)
    wide, high = max(font.size(line)[0] for line in lines), font.get_linesize() * len(lines)
    fits = min(1.0, MOST_SHARE * room_px[0] / (wide + 16), MOST_SHARE * room_px[1] / (high + 12))
    if fits < 1:
        font = _font(max(LEAST_PX, int(text_px * fits)))
    texts = [font.render(line, True, (255, 255, 255)) for line in lines]
    step, small = font.get_linesize(), None
    width, height = max(text.get_width() for text in texts) + 16, step * len(texts) + 12
    if inset is not None and height + inset.shape[0] + 8 <= room_px[1]:
        small = pygame.image.frombuffer(inset[:, :, ::-1].tobytes(), (inset.shape[1], inset.shape[0]), "RGB")
        width, height = max(width, small.get_width() + 16), height + small.get_height() + 8
    made = pygame.Surface((width, height), pygame.SRCALPHA)
    made.fill((0, 0, 0, 160))
    for index, text in enumerate(texts):
        made.blit(text, (8, 6 + index * step))
    if small is not None:
        made.blit(small, (8, height - small.get_height() - 8))
    return made
