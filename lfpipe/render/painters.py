"""Painters put a picture into a window: SDL's renderer scales it and swaps in step with the screen; the processor fills the
window's surface.
"""

from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_area
from lfpipe.render.pair_layout import scale_into
from lfpipe.render.window_system import drawable, pygame, video

RED_MASKS = {0xFF0000: cv2.COLOR_BGR2BGRA, 0xFF: cv2.COLOR_BGR2RGBA}
Panels = list[tuple[pygame.Surface, tuple[int, int]]]  # overlays of the picture and their positions


class Painter(Protocol):
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the window in the screen's own pixels."""
        ...

    def paint(self, picture: NDArray[np.uint8], panels: Panels, exact: bool) -> None:
        """Draws uint8 (height, width, 3) BGR, scaled to fit, without showing it. exact: it already has the window's size."""
        ...

    def swap(self) -> None:
        """Hands the drawn picture to the window system."""
        ...


class SurfacePainter:
    """Writes into the window's surface with as few copies as possible."""

    def __init__(self, window: pygame.Window) -> None:
        """Raises UserError if the screen's pixels do not have 32 bits."""
        self._window = window
        self._four: NDArray[np.uint8] = np.empty((0, 0, 4), np.uint8)
        surface = window.get_surface()
        if surface.get_bytesize() != 4 or surface.get_masks()[0] not in RED_MASKS:
            raise UserError(f"the screen has {surface.get_bitsize()} bits per pixel", "use a screen with 24 or 32 bits per pixel")

    def size_px(self) -> tuple[int, int]:
        return self._window.get_surface().get_size()

    def paint(self, picture: NDArray[np.uint8], panels: Panels, exact: bool) -> None:
        surface = self._window.get_surface()
        self._write(surface, picture)
        for panel, at in panels:
            surface.blit(panel, at)

    def swap(self) -> None:
        self._window.flip()

    def _write(self, surface: pygame.Surface, picture: NDArray[np.uint8]) -> None:
        # the views of the surface's memory end with this call: the surface is locked as long as one lives
        width, height = surface.get_size()
        memory: Any = surface.get_buffer()  # a buffer, though the type checker disagrees
        pixels = np.frombuffer(memory, np.uint8).reshape(height, surface.get_pitch() // 4, 4)[:, :width]
        x, y, w, h = fit_area((picture.shape[1], picture.shape[0]), (width, height))
        code = RED_MASKS[surface.get_masks()[0]]
        pixels[:y], pixels[y + h :], pixels[y : y + h, :x], pixels[y : y + h, x + w :] = 0, 0, 0, 0
        target = pixels[y : y + h, x : x + w]
        if picture.shape[:2] == (h, w):
            cv2.cvtColor(picture, code, dst=target)
            return
        # converted before scaling up: the scaler then writes straight into the surface
        if self._four.shape[:2] != picture.shape[:2]:
            self._four = np.empty((*picture.shape[:2], 4), np.uint8)
        cv2.cvtColor(picture, code, dst=self._four)
        scale_into(self._four, target)


class RendererPainter:
    """Uploads pictures of their own size to a streaming texture; SDL's renderer scales them and swaps."""

    def __init__(self, window: pygame.Window, wait: bool) -> None:
        """wait: `swap` waits for the screen. Raises pygame.error without an accelerated renderer."""
        self._renderer = video.Renderer(window, -1, 1, wait)
        self._texture: video.Texture | None = None
        self._four: NDArray[np.uint8] = np.empty((0, 0, 4), np.uint8)
        self._upload: pygame.Surface | None = None
        self._panels: dict[int, tuple[pygame.Surface, video.Texture]] = {}

    def size_px(self) -> tuple[int, int]:
        viewport = self._renderer.get_viewport()
        return viewport.width, viewport.height

    def paint(self, picture: NDArray[np.uint8], panels: Panels, exact: bool) -> None:
        rows, cols = picture.shape[:2]
        if self._texture is None or self._four.shape[:2] != (rows, cols):
            self._four = np.empty((rows, cols, 4), np.uint8)
            self._upload = pygame.image.frombuffer(self._four.data, (cols, rows), "BGRA")
            self._texture = video.Texture(self._renderer, (cols, rows), streaming=True, scale_quality=0 if exact else 1)
        assert self._upload is not None
        cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA, dst=self._four)
        self._texture.update(self._upload)
        self._renderer.clear()
        self._texture.draw(dstrect=fit_area((cols, rows), self.size_px()))
        kept = {}
        for panel, (x, y) in panels:
            drawn = self._panels.get(id(panel)) or (panel, video.Texture.from_surface(self._renderer, panel))
            kept[id(panel)] = drawn
            drawn[1].draw(dstrect=(x, y, *panel.get_size()))
        self._panels = kept

    def swap(self) -> None:
        self._renderer.present()


def open_painter(window: pygame.Window, renderer: bool, wait: bool) -> Painter:
    """The renderer if wanted and available, else the surface. Raises UserError as `SurfacePainter` does."""
    if renderer:
        try:
            return RendererPainter(window, wait)
        except pygame.error:
            pass
    return SurfacePainter(window)


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
