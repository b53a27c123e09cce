"""The overlay of one window: its panels, and what a key, a click or a touch on them means."""

import time
from collections.abc import Callable

import attrs

from lfpipe.render.overlay import HELP, Overlay, Pointer
from lfpipe.render.panels import Panel, Place, bar_panel, menu_panel, progress_panel, slider_event, text_panel
from lfpipe.render.window_system import pygame

HINT_S, BAR_S = 6.0, 3.0  # the hint stays; the bar stays after the last move of the mouse
PAGES = {"next": 1, "previous": -1}


def moved(pointer: Pointer, event: pygame.Event, window_size: Place) -> Pointer:
    """The pointer after an event of the mouse. window_size: in the units of the event."""
    if event.type == pygame.MOUSEWHEEL:
        return attrs.evolve(pointer, wheel=pointer.wheel + event.y)
    x, y = (min(max(at / size, 0.0), 1.0) for at, size in zip(event.pos, window_size, strict=True))
    pointer = attrs.evolve(pointer, x=x, y=y)
    if event.type == pygame.MOUSEMOTION or event.button not in (1, 3):
        return pointer
    return attrs.evolve(pointer, **{"left" if event.button == 1 else "right": event.type == pygame.MOUSEBUTTONDOWN})


class Layers:
    """hint: a line at the top for HINT_S, or until a key is pressed. help: whether the keys are listed."""

    def __init__(self, hint: str) -> None:
        self.overlay, self.help = Overlay(), False
        self._hint, self._hint_end_s, self._bar_end_s = hint, time.monotonic() + HINT_S, 0.0
        self._at, self._marked = 0, ""  # the item selected in the menu; the event lit in the bar
        self._held: Callable[[int], str] | None = None  # the event of a slider held at x
        self._panels: list[Panel] = []

    def set(self, overlay: Overlay) -> None:
        """Replaces the overlay."""
        old, menu = self.overlay.menu, overlay.menu
        if menu is not None:
            self._at = menu.at if old is None or old.title != menu.title else min(self._at, len(menu.items) - 1)
        self.overlay = overlay

    @property
    def has_pointer(self) -> bool:
        """Whether there is something to point at."""
        return self.overlay.menu is not None or self._bar_end_s > 0

    def panels(self, window_px: Place, text_px: int) -> list[Panel]:
        """The panels, the topmost last; equal calls return the same ones. window_px: (width, height)."""
        overlay, t_s, (width, bottom_px) = self.overlay, time.monotonic(), window_px
        self._hint = self._hint if t_s < self._hint_end_s else ""
        if (t_s > self._bar_end_s and self._held is None) or not overlay.bar or overlay.menu is not None:
            self._bar_end_s = 0.0
        lines = (*overlay.lines, *(HELP if self.help else ()))
        if self._hint and not lines and overlay.menu is None:
            lines = (self._hint,)
        panels = [text_panel(Overlay(lines, overlay.inset), None, window_px, text_px)] if lines else []
        if self._bar_end_s:
            panels.append(bar_panel(overlay.bar, self._marked, window_px, text_px))
            bottom_px = panels[-1].at[1]
        if overlay.progress is not None:
            panels.append(progress_panel(overlay.progress, window_px))
        if overlay.notices:
            panels.append(text_panel(Overlay(overlay.notices), bottom_px, window_px, text_px))
            bottom_px = panels[-1].at[1]
        if overlay.menu is not None:
            menu = menu_panel(overlay.menu, self._at, window_px, text_px)
            if menu.bottom > bottom_px:  # above the notices
                menu = menu_panel(overlay.menu, self._at, (width, bottom_px), text_px)
            panels.insert(0, menu)
        self._panels = panels
        return panels

    def key(self, name: str) -> str:
        """The event that a key causes; "" if it only moves the selection."""
        self._hint = ""
        menu = self.overlay.menu
        if name == "escape":
            return "help" if self.help else "close" if menu is not None else name
        if menu is None or not menu.items:
            return name
        panel = next(panel for panel in self._panels if panel.cells)
        moves = {"less": -1, "more": 1, "up": -panel.cols, "down": panel.cols}
        moves |= {key: sign * panel.page for key, sign in PAGES.items()}
        event = menu.items[self._at].event
        if name in moves:
            at, last = self._at + moves[name], len(menu.items) - 1
            self._at = at % (last + 1) if name in ("less", "more") else min(max(at, 0), last)
            return ""
        return {"enter": event, "delete": f"delete {event}"}.get(name, name)

    def mouse(self, event: pygame.Event, at_px: Place) -> str:
        """The event that the mouse or a touch causes, "" for none. at_px: the pointer."""
        self._bar_end_s = time.monotonic() + BAR_S
        over = next(filter(None, (panel.cell(at_px) for panel in reversed(self._panels))), None)
        self._marked = over[0].event if over is not None else ""
        if event.type == pygame.MOUSEBUTTONUP:
            self._held = None
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and over is not None:
            item, rect = over
            if item.slider is None:
                return item.event
            self._held = lambda x: slider_event(item, rect, x)
        return self._held(at_px[0]) if self._held is not None else ""
