"""What lies over the picture in the window: text, help, menu, progress and the bar, with what a click on them means."""

import time
from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.bar import SHOWN_S, Bar
from lfpipe.render.display import KEYS, BarState, Pointer
from lfpipe.render.painters import Panels, panel
from lfpipe.render.window_system import pygame

MOUSE = (pygame.MOUSEMOTION, pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP, pygame.MOUSEWHEEL)
HINT_S = 6.0
MENU_SHARE = 0.9  # of the window, at most
PROGRESS_PX = 4
EDGE_PX = 12
Place = tuple[int, int]


def moved(pointer: Pointer, event: pygame.Event, window_size: Place) -> Pointer:
    """The pointer after an event of the mouse. window_size: in the units of the event."""
    if event.type == pygame.MOUSEWHEEL:
        return attrs.evolve(pointer, wheel=pointer.wheel + event.y)
    x, y = (min(max(at / size, 0.0), 1.0) for at, size in zip(event.pos, window_size, strict=True))
    held = {"left": pointer.left, "right": pointer.right}
    if event.type != pygame.MOUSEMOTION and event.button in (1, 3):
        held["left" if event.button == 1 else "right"] = event.type == pygame.MOUSEBUTTONDOWN
    return Pointer(x, y, **held, wheel=pointer.wheel)


class Layers:
    """Surfaces over the picture, made anew by `place` when the window's size or their content changes. hint: a line for HINT_S,
    or until a key is pressed."""

    def __init__(self, hint: str) -> None:
        self.lines: list[str] = []
        self.inset: NDArray[np.uint8] | None = None
        self.help = False
        self.words: list[str] = []  # short lines at the bottom
        self.progress: float | None = None  # share of a thin line along the bottom; None without
        self.menu: Callable[[Place], pygame.Surface] | None = None
        self.bar_state = BarState()
        self._hint, self._hint_end_ns = hint, time.monotonic_ns() + int(HINT_S * 1e9)
        self._bar, self._bar_until_ns, self._lit = Bar(), 0, ""
        self._size_px, self._text_px = (1, 1), 1
        self._top: pygame.Surface | None = None
        self._bottom: pygame.Surface | None = None
        self._middle: pygame.Surface | None = None

    def place(self, size_px: Place, text_px: int) -> None:
        """Draws the text and the menu for a window of (width, height) px."""
        self._size_px, self._text_px = size_px, text_px
        lines = [*self.lines, *([f"{key}\t{text}" for key, (_, text) in KEYS.items()] if self.help else [])]
        if self._hint and not lines and self.menu is None:
            lines = [self._hint]
        room = size_px[0] - 2 * EDGE_PX, size_px[1] - 2 * EDGE_PX
        self._top = panel(lines, self.inset, text_px, room) if lines else None
        self._bottom = panel(self.words, None, text_px, room) if self.words else None
        self._middle = self.menu((round(MENU_SHARE * size_px[0]), round(MENU_SHARE * size_px[1]))) if self.menu else None

    def panels(self, at_px: Place) -> Panels:
        """The surfaces with their positions. at_px: the pointer."""
        (width, height), below_px = self._size_px, 0
        found: Panels = []
        if self._middle is not None:
            found.append((self._middle, self._menu_at()))
        if self._top is not None:
            found.append((self._top, (EDGE_PX, EDGE_PX)))
        if self._bar_until_ns and self.menu is None:
            bar = self._bar.draw(self._size_px, self._text_px, self.bar_state, self._in_bar(at_px))
            below_px = bar.get_height()
            found.append((bar, (0, height - below_px)))
        if self.progress is not None:
            line = pygame.Surface((max(1, round(self.progress * width)), PROGRESS_PX))
            line.fill((255, 255, 255))
            found.append((line, (0, height - PROGRESS_PX)))
        if self._bottom is not None:
            wide, high = self._bottom.get_size()
            found.append((self._bottom, ((width - wide) // 2, height - high - EDGE_PX - below_px)))
        return found

    @property
    def closes(self) -> str:
        """The event of the key that closes what lies over the picture; "" if nothing does."""
        return "help" if self.help else "choose" if self.menu else ""

    def mouse(self, event: pygame.Event, at_px: Place) -> tuple[str, bool]:
        """What an event of the mouse means for menu and bar, "" for nothing, and whether the bar looks different now."""
        pressed = event.type == pygame.MOUSEBUTTONDOWN and event.button == 1
        if pressed and self._middle is not None:
            x, y = self._menu_at()
            return f"click {at_px[0] - x} {at_px[1] - y}", False
        appears, before = not self._bar_until_ns, self._lit
        self._bar_until_ns = time.monotonic_ns() + int(SHOWN_S * 1e9)
        inside = self._in_bar(at_px)
        self._lit = self._bar.entry(inside)
        name = ""
        if event.type == pygame.MOUSEBUTTONUP:
            self._bar.release()
        elif event.type == pygame.MOUSEMOTION:
            name = self._bar.slide(at_px[0])
        elif pressed and inside is not None:
            name = self._bar.press(*inside)
        return name, appears or self._lit != before or bool(name)

    def expire(self, keyed: bool, held: bool) -> bool:
        """Removes hint and bar when their time is over; returns whether one went. keyed: a key was pressed. held: a button is."""
        now_ns, went = time.monotonic_ns(), False
        if self._hint and (keyed or now_ns > self._hint_end_ns):
            self._hint, went = "", True
            self.place(self._size_px, self._text_px)
        if self._bar_until_ns and now_ns > self._bar_until_ns and not held:
            self._bar_until_ns, went = 0, True
        return went

    @property
    def bar_is_shown(self) -> bool:
        return bool(self._bar_until_ns)

    def _menu_at(self) -> Place:
        (width, height), (wide, high) = self._size_px, self._middle.get_size() if self._middle else (0, 0)
        return (width - wide) // 2, (height - high) // 2

    def _in_bar(self, at_px: Place) -> Place | None:
        """A place of the window in px of the bar; None outside of it, or under a menu."""
        if self._bar.surface is None or not self._bar_until_ns or self.menu is not None:
            return None
        y = at_px[1] - self._size_px[1] + self._bar.surface.get_height()
        return (at_px[0], y) if y >= 0 else None
