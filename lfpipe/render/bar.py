"""The bar at the bottom of the window: what a viewer changes, to click or touch. It appears when the mouse moves.

Every entry does what its key does, and shows that key. The bar never covers the middle of the picture.
"""

import attrs

from lfpipe.render.display import BarState
from lfpipe.render.window_system import pygame

SHOWN_S = 3.0  # after the last move of the mouse
LEAST_TEXT_PX, WIDE = 12, 36  # smallest text; a window this many text heights wide has room for the usual size
HIGH = 0.3  # of the window, at most
WHITE, GREY, BACK, LIT, DARK = (255, 255, 255), (170, 170, 170), (0, 0, 0, 200), (90, 90, 90, 220), (70, 70, 70)
SLIDER = "depth"  # event "depth S", S from 0 to 1
ENTRIES = (
    ("choose", "Scene", "Tab"),
    ("open", "Open folder", "l"),
    ("open-file", "Open file", "i"),
    ("which", "Glasses", "e"),
    (SLIDER, "Depth", "+ -"),
    ("half-turn", "Near/far", "d"),
    ("recentre", "Straight ahead", "c"),
    ("record", "Record", "r"),
    ("screenshot", "Save picture", "s"),
    ("fullscreen", "Full screen", "f"),
    ("help", "Help", "h"),
)


@attrs.frozen
class _Cell:
    """An entry in its place, px of the bar."""

    event: str
    label: str
    key: str
    rect: pygame.Rect


class Bar:
    """The bar of one window. surface: its picture; None before `draw`."""

    def __init__(self) -> None:
        self.surface: pygame.Surface | None = None
        self._drawn: tuple[object, ...] = ()
        self._cells: list[_Cell] = []
        self._groove = pygame.Rect(0, 0, 0, 0)  # of the slider
        self._sliding = False

    def draw(self, window_px: tuple[int, int], text_px: int, state: BarState, at: tuple[int, int] | None) -> pygame.Surface:
        """The bar for a window of (width, height) px. at: the pointer, px of the bar; its entry is lit."""
        lit = self.entry(at)
        if self._drawn != (window_px, text_px, state, lit) or self.surface is None:
            self._drawn = (window_px, text_px, state, lit)
            self.surface = self._drawing(window_px, text_px, state, lit)
        return self.surface

    def _drawing(self, window_px: tuple[int, int], text_px: int, state: BarState, lit: str) -> pygame.Surface:
        width, height = window_px
        size_px = max(LEAST_TEXT_PX, min(text_px, width // WIDE))
        font, rows = self._placed(size_px, width, state)
        while rows > 1 and size_px > LEAST_TEXT_PX and (2 * rows + 1) * font.get_linesize() > HIGH * height:
            size_px -= 1
            font, rows = self._placed(size_px, width, state)
        line = font.get_linesize()
        surface = pygame.Surface((width, rows * _row_px(line)), pygame.SRCALPHA)
        surface.fill(BACK)
        for cell in self._cells:
            if cell.event == lit:
                surface.fill(LIT, cell.rect)
            label = font.render(cell.label, True, (255, 90, 90) if cell.event == "record" and state.recording else WHITE)
            surface.blit(label, label.get_rect(midtop=(cell.rect.centerx, cell.rect.top + line // 4)))
            if cell.event == SLIDER:
                self._draw_slider(surface, font, cell, state.depth)
            else:
                key = font.render(cell.key, True, GREY)
                surface.blit(key, key.get_rect(midtop=(cell.rect.centerx, cell.rect.top + line // 4 + line)))
        return surface

    def _placed(self, size_px: int, width: int, state: BarState) -> tuple[pygame.font.Font, int]:
        """Places the entries in rows; returns the font and the number of rows."""
        font = pygame.font.Font(None, size_px)
        line, x, row, self._cells = font.get_linesize(), 0, 0, []
        wides = []
        for event, label, key in ENTRIES:
            if event in state.without:
                continue
            text = "Stop recording" if event == "record" and state.recording else label
            wide = 12 * line if event == SLIDER else font.size(text)[0] + line
            if x + wide > width and x:
                x, row = 0, row + 1
            self._cells.append(_Cell(event, text, key, pygame.Rect(x, row * _row_px(line), wide, _row_px(line))))
            wides.append(row)
            x += wide
        for number in set(wides):  # spread over the width
            cells = [k for k, found in enumerate(wides) if found == number]
            spare = (width - sum(self._cells[k].rect.width for k in cells)) // len(cells)
            for place, k in enumerate(cells):
                rect = self._cells[k].rect.move(place * spare, 0)
                self._cells[k] = attrs.evolve(self._cells[k], rect=pygame.Rect(rect.x, rect.y, rect.width + spare, rect.height))
        return font, row + 1

    def _draw_slider(self, surface: pygame.Surface, font: pygame.font.Font, cell: _Cell, depth: float) -> None:
        line = font.get_linesize()
        y = cell.rect.top + line // 4 + line
        low, high = font.render("comfort", True, GREY), font.render("true", True, GREY)
        surface.blit(low, (cell.rect.left + line // 2, y))
        surface.blit(high, (cell.rect.right - line // 2 - high.get_width(), y))
        left = cell.rect.left + line + low.get_width()
        self._groove = pygame.Rect(left, y + line // 2 - 2, max(cell.rect.right - line - high.get_width() - left, 8), 4)
        pygame.draw.rect(surface, GREY, self._groove, border_radius=2)
        knob = self._groove.left + round(min(max(depth, 0.0), 1.0) * self._groove.width), self._groove.centery
        pygame.draw.circle(surface, WHITE, knob, max(5, line // 3))

    def entry(self, at: tuple[int, int] | None) -> str:
        """The event of the entry at a place of the bar; "" where there is none."""
        return next((cell.event for cell in self._cells if at is not None and cell.rect.collidepoint(at)), "")

    def press(self, x: int, y: int) -> str:
        """The event of a click or touch at (x, y) px of the bar; "" where there is none."""
        event = self.entry((x, y))
        self._sliding = event == SLIDER
        return self.slide(x) if self._sliding else event

    def slide(self, x: int) -> str:
        """The event of a pointer held at x px of the bar; "" unless it holds the slider."""
        if not self._sliding or not self._groove.width:
            return ""
        return f"{SLIDER} {min(max((x - self._groove.left) / self._groove.width, 0.0), 1.0):.2f}"

    def release(self) -> None:
        """The pointer is no longer held."""
        self._sliding = False


def _row_px(line: int) -> int:
    return 2 * line + line // 2
