"""The overlay in a window: arranges its panels, and maps keys, clicks and touches to events."""

import math
import time

import attrs

from lfpipe.render.display import ACCENT, RED
from lfpipe.render.display.display import (
    ACTION_OF,
    CLOSE,
    NO_EVENT,
    VIEWERS,
    Event,
    Item,
    Menu,
    Overlay,
)
from lfpipe.render.display.look import (
    AMBER,
    NO_HIGHLIGHT,
    Highlight,
    Point,
    slider_groove,
)
from lfpipe.render.display.panels import (
    EDGE_PX,
    GAP_PX,
    TURNS,
    Cell,
    Panel,
    bar_panel,
    caption_panels,
    dot_panel,
    menu_panel,
    notice_panel,
    scene_panel,
    text_panel,
    tip_panel,
    top_px,
)
from lfpipe.render.display.window_system import pygame

BAR_S = 3.0  # how long the bar stays once the pointer has left it: time to read its entries
REST_S = 0.5  # people who look around with the mouse pause for less
BAR_EDGE = 0.1  # of the height: pointer motion there shows the bar at once
KEY_ACTIONS = ACTION_OF | {
    "tab": "choose",
    "f11": "fullscreen",
    "=": "alpha+",
    " ": "freeze",
    "?": "help",
    "i": "open",
    "enter": "enter",
    "left": "less",
    "right": "more",
    "pagedown": "next",
    "pageup": "previous",
}
# keys in a menu: onwards or back
MOVES = {"left": -1, "right": 1, "up": -1, "down": 1, "pageup": -1, "pagedown": 1}
PRESSED_OR_NOT = (pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP)
SMALL = 4  # over the height of the chips: below it, pages lie over them


@attrs.define(eq=False, slots=False)
class OverlayView:
    """Draws an overlay, and maps input on it to events."""

    _overlay: Overlay = attrs.field(factory=Overlay)
    drawn: list[Panel] = attrs.field(factory=list)
    """The last `panels`."""
    _at: int = 0  # the selected item of the menu
    _over: Cell | None = None  # what the pointer is on
    _pressed: bool = False  # whether that is pressed
    _used: Event = NO_EVENT  # pressed, and the pointer is still there: it needs no tip
    _slider: Cell | None = None  # that is dragged
    _bar: Panel | None = None  # while it is shown
    _pointer_px: Point = (-1, -1)
    _bar_from_s: float = math.inf  # when the bar appears, for BAR_S
    _edge_px: int = 0  # pointer motion below shows the bar or keeps it
    _menu: Panel | None = None

    def set(self, overlay: Overlay) -> None:
        """Replaces the overlay."""
        old, menu = self._overlay.menu, overlay.menu
        if menu is not None:
            self._at = (
                menu.at
                if old is None or old.title != menu.title
                else min(self._at, len(menu.items) - 1)
            )
        self._overlay = overlay

    @property
    def has_pointer(self) -> bool:
        """Whether the pointer has a target."""
        return bool(self._overlay.menu or self._overlay.items) or self._bar_from_s < math.inf

    def _highlight_of(self, *items: Item) -> Highlight:
        """What is lit of some items: the others need not be drawn again."""
        event = self._over[0].event if self._over else NO_EVENT
        is_one = event.name and any(item.event == event for item in items)
        return Highlight(event, self._pressed) if is_one else NO_HIGHLIGHT

    def panels(self, window_px: Point, text_px: int) -> list[Panel]:
        """The panels, the topmost last; equal calls return the same ones.

        window_px: (width, height).
        """
        overlay = self._overlay
        now_s = time.monotonic()
        bar, at = None, self._pointer_px
        if overlay.bar:
            bar = bar_panel(overlay.bar, self._highlight_of(*overlay.bar), window_px, text_px)
        if bar is None or now_s > self._bar_from_s + BAR_S:
            self._bar_from_s = math.inf
        is_used = self._slider is not None or bool(self._bar and self._bar.rect.collidepoint(at))
        is_awake = bar is not None and (now_s >= self._bar_from_s or is_used)
        if is_awake and is_used:
            self._bar_from_s = now_s
        if bar is not None and is_awake and self._bar is None and self._over is None:
            self._over = bar.cell(at)  # the bar has come under the pointer
        self._bar = bar if is_awake else None
        # space for the bar stays free, so that nothing moves when it appears
        bar_top_px = bottom_px = window_px[1] if bar is None else bar.rect.top
        corners = self._corners(is_awake, window_px, text_px)
        below_px = max([top_px(text_px), *(one.rect.bottom + GAP_PX for one in corners)])
        pages, notices = list[Panel](), list[Panel]()
        if overlay.lines:
            page = Overlay(
                title=overlay.title, lines=overlay.lines, inset=overlay.inset, items=overlay.items
            )
            lit = self._highlight_of(CLOSE, *overlay.items)
            from_px = EDGE_PX if overlay.items or bar_top_px < SMALL * below_px else below_px
            pages.append(text_panel(page, bar_top_px, window_px, text_px, from_px, lit))
            bottom_px = pages[0].rect.top if overlay.items else bottom_px
        bottom_px -= GAP_PX
        if overlay.caption:
            lit = self._highlight_of(*overlay.items)
            shown = Overlay(caption=overlay.caption, items=overlay.items, elapsed=overlay.elapsed)
            pages += caption_panels(shown, bottom_px - EDGE_PX, window_px, text_px, lit)
            bottom_px = min(panel.rect.top for panel in pages) - GAP_PX
        for notice in reversed(overlay.notices):
            if notice.items and overlay.menu is not None:  # one question at a time
                continue
            lit = self._highlight_of(*notice.items)
            if notice.items and not overlay.lines:
                notices.append(notice_panel(notice, below_px, True, window_px, text_px, lit))
                below_px = notices[-1].rect.bottom + GAP_PX
            else:
                notices.append(notice_panel(notice, bottom_px, False, window_px, text_px, lit))
                bottom_px = notices[-1].rect.top - GAP_PX
        self._menu = None
        if overlay.menu is not None:
            lit = self._highlight_of(CLOSE, *TURNS, *overlay.menu.items)
            corners = corners[:1] if overlay.recording else []
            over_px = max((corner.rect.bottom for corner in corners), default=0)
            self._menu = menu_panel(
                overlay.menu, self._at, (window_px[0], bar_top_px), text_px, lit, over_px
            )
            pages.append(self._menu)
        self.drawn = [*pages, *notices, *corners]
        self._edge_px = bar_top_px if is_awake else round((1 - BAR_EDGE) * window_px[1])
        if self._bar is not None:
            self.drawn.append(self._bar)
            item, rect = self._over or (CLOSE, pygame.Rect(0, 0, 0, 0))
            is_bare = item in overlay.bar and (item.off or item.event.name in self._bar.bare)
            if is_bare and item.event != self._used:
                self.drawn.append(tip_panel(item, (rect.centerx, bar_top_px), window_px, text_px))
        return self.drawn

    def _corners(self, is_awake: bool, window_px: Point, text_px: int) -> list[Panel]:
        """The recording, the viewer and the scene in the upper corners."""
        overlay = self._overlay
        panels = list[Panel]()
        dot = AMBER if overlay.viewer == VIEWERS["demo"] else ACCENT
        y = EDGE_PX
        for text, colour in ((overlay.recording, RED), (overlay.viewer * is_awake, dot)):
            if text:
                panels.append(dot_panel(text, colour, y, window_px, text_px))
                y = panels[-1].rect.bottom + GAP_PX
        if overlay.step or (overlay.scene and (is_awake or overlay.caption)):
            panels.append(
                scene_panel(overlay.scene, overlay.step, overlay.progress, window_px, text_px)
            )
        return panels

    def key(self, key: str) -> Event | None:
        """The event of a key: a letter, or a name as "escape"; None if it only moves the
        selection.
        """
        menu = self._overlay.menu
        if key == "escape":
            return Event("close" if menu or self._overlay.lines else "leave-fullscreen")
        if menu is not None and self._menu is not None:
            if key in MOVES:
                self._at = self._moved(menu, self._menu.rects, key)
                return None
            if key == "enter":
                return menu.items[self._at].event
        return Event(KEY_ACTIONS[key]) if key in KEY_ACTIONS else None

    def _moved(self, menu: Menu, rects: dict[int, pygame.Rect], key: str) -> int:
        """The number of the item that a key selects."""
        usable = [number for number, item in enumerate(menu.items) if item.event.name]
        step = MOVES[key]
        if key in ("left", "right"):
            return usable[(usable.index(self._at) + step) % len(usable)]
        here = rects.get(self._at, pygame.Rect(0, 0, 0, 0))  # another page is not drawn yet
        beyond = [
            (abs(rect.top - here.top), abs(rect.left - here.left), number)
            for number, rect in rects.items()
            if number in usable and (rect.top - here.top) * step > 0
        ]
        if beyond and key in ("up", "down"):
            return min(beyond)[2]
        others = [number for number in usable if (number - self._at) * step > 0]
        elsewhere = [number for number in others if number not in rects] or others or [self._at]
        return elsewhere[0 if step > 0 else -1]

    def mouse(self, event: pygame.Event, at_px: Point) -> Event | None:
        """The event of the mouse or a touch. at_px: the pointer."""
        if event.type == pygame.MOUSEWHEEL:
            if self._menu is None:
                return None
            return self.key("pageup" if event.y > 0 else "pagedown") or NO_EVENT
        self._pointer_px = at_px
        at_once = at_px[1] >= self._edge_px or event.type in PRESSED_OR_NOT
        self._bar_from_s = time.monotonic() + (0.0 if at_once else REST_S)
        self._over = next(filter(None, (panel.cell(at_px) for panel in self.drawn[::-1])), None)
        lit = self._over[0].event if self._over is not None else NO_EVENT
        is_down = event.type == pygame.MOUSEBUTTONDOWN or (
            self._pressed and event.type == pygame.MOUSEMOTION
        )
        self._pressed = is_down and bool(lit.name)
        if is_down or lit != self._used:
            self._used = lit if is_down else NO_EVENT
        if event.type == pygame.MOUSEBUTTONUP:
            self._slider = None
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and self._over is not None:
            item = self._over[0]
            if item.off:
                return NO_EVENT
            if item.event.name in ("pageup", "pagedown"):
                return self.key(item.event.name)
            if item.slider is None:
                return item.event
            self._slider = self._over
        if self._slider is None:
            return None
        item, rect = self._slider
        groove = slider_groove(rect)
        value = min(max((at_px[0] - groove.left) / groove.width, 0.0), 1.0)
        return attrs.evolve(item.event, value=round(value, 2))
