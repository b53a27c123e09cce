"""The overlay of the picture: lines of text and a small picture below them, white on black."""

import numpy as np
from numpy.typing import NDArray

from lfpipe.render.sdl import drawable, pygame

LEAST_PX, MOST_SHARE = 13, 0.94  # of the text, and the share of the window that the overlay may take


COLUMN = "PgDnM"  # as wide as the keys of the help


def _width_px(font: pygame.font.Font, line: str) -> int:
    before, tab, after = line.partition("\t")
    return font.size(COLUMN)[0] + font.size(after)[0] if tab else font.size(before)[0]


def _font(size_px: int) -> pygame.font.Font:
    return pygame.font.Font(None, size_px)


def panel(lines: list[str], inset: NDArray[np.uint8] | None, text_px: int, room_px: tuple[int, int]) -> pygame.Surface:
    """A translucent surface with lines of text_px, smaller if they do not fit into room_px (width, height).

    Text after a tab forms a second column.

    inset: uint8 (h, w, 3) BGR, left out if there is no room. White on black is the same for both eyes, so text lies in the plane
    of the screen through any glasses.
    """
    lines = [drawable(line) for line in lines]
    font = _font(text_px)
    wide, high = max(_width_px(font, line) for line in lines), font.get_linesize() * len(lines)
    fits = min(1.0, MOST_SHARE * room_px[0] / (wide + 16), MOST_SHARE * room_px[1] / (high + 12))
    if fits < 1:
        font = _font(max(LEAST_PX, int(text_px * fits)))
    column_px = font.size(COLUMN)[0]
    texts = [
        (8 + column_px * number, index, font.render(part, True, (255, 255, 255)))
        for index, line in enumerate(lines)
        for number, part in enumerate(line.split("\t", 1))
    ]
    step, small = font.get_linesize(), None
    width, height = max(x + text.get_width() for x, _, text in texts) + 8, step * len(lines) + 12
    if inset is not None and height + inset.shape[0] + 8 <= room_px[1]:
        small = pygame.image.frombuffer(inset[:, :, ::-1].tobytes(), (inset.shape[1], inset.shape[0]), "RGB")
        width, height = max(width, small.get_width() + 16), height + small.get_height() + 8
    made = pygame.Surface((width, height), pygame.SRCALPHA)
    made.fill((0, 0, 0, 160))
    for x, index, text in texts:
        made.blit(text, (x, 6 + index * step))
    if small is not None:
        made.blit(small, (8, height - small.get_height() - 8))
    return made
