"""The overlay in a window: draws its panels, and maps keys, clicks and touches to events.

A panel is a surface with the rectangles of its items, so a click finds what is drawn there. Two
equal calls of a panel's function in a row return the same panel.
"""

import math
import time
from functools import lru_cache

import attrs
import cv2

from lfpipe.files.decoding import fit_area
from lfpipe.render.display.overlay import NO_EVENT, Event, Item, Menu, Overlay
from lfpipe.render.display.painters import Panel
from lfpipe.render.display.window_system import drawable, font, pygame
from lfpipe.render.ui.keys import ACTION_OF, CLOSE

Place = tuple[int, int]
Cell = tuple[Item, pygame.Rect]
BAR_S = 3.0  # how long the bar stays: time to read its entries
REST_S = 0.5  # people who look around with the mouse pause for less
BAR_EDGE = 0.1  # of the height: pointer motion there shows the bar at once
KEY_ACTIONS = ACTION_OF | {
    "tab": "choose",
    "f11": "fullscreen",
    "=": "alpha+",
    " ": "freeze",
    "?": "help",
    "enter": "enter",
    "left": "less",
    "right": "more",
    "pagedown": "next",
    "pageup": "previous",
}
PAGES = (("◀", "pageup"), ("▶", "pagedown"))  # labels and keys of the previous and next page
PRESSED = (pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP)
WHITE = (255, 255, 255)
GREY = (170, 170, 170)
RED = (255, 90, 90)
BACK = (0, 0, 0, 200)
LIT = (90, 90, 90, 220)
TEXT_BACK = (0, 0, 0, 160)
# from the window's edge, around text; height of the line of progress
EDGE_PX, PAD_PX, PROGRESS_PX = 12, 8, 4
GAP_PX = 2  # between two notices
MIN_TEXT_PX = 12  # still legible
# of the window that lines of text may take: the picture below stays visible
TEXT_SHARE = 0.94
COLUMN = "PgDn PgUpM"  # as wide as the keys of the help
# of the height, at most: not the middle; width of a window for two rows, in text heights; and the
# least size of letters in two rows
BAR_SHARE, BAR_LETTERS, BAR_TEXT_PX = 0.3, 40, 14
SLIDER_CELLS = 2  # width of a slider in the bar: a pixel is about a percent in a small window
# Of the window, at most; cells across, at most, and their least size in lines of text: a picture
# says more than its label.
MENU_SHARE, MENU_COLS, CELL_LINES = 0.9, 5, 6
CELL_SHAPE = 0.75  # height over width of a cell's picture, at most: most cameras' views fill it


@attrs.frozen(eq=False, kw_only=True)
class ItemPanel(Panel):
    """A panel with items."""

    cells: list[Cell] = attrs.field(factory=list)
    """Items with their rectangles on the surface."""
    cols: int = 1
    """Columns of a menu."""
    page: int = 1
    """Items on one page of a menu."""

    def cell(self, place: Place) -> Cell | None:
        """The item at a place of the window, and its rectangle in the window."""
        return next(
            (
                (item, rect.move(self.at))
                for item, rect in self.cells
                if rect.move(self.at).collidepoint(place)
            ),
            None,
        )


def _groove(rect: pygame.Rect) -> pygame.Rect:
    """Where a slider moves in its item's rectangle."""
    return rect.inflate(-0.2 * rect.width, 0)


def _span(item: Item) -> int:
    return 1 if item.slider is None else SLIDER_CELLS


def _cells(items: tuple[Item, ...], cols: int, width: int, height: int, top: int = 0) -> list[Cell]:
    """The items in rows of cols cells of that size, below top; a slider takes SLIDER_CELLS."""
    cells: list[Cell] = []
    col = row = 0
    for item in items:
        span = min(_span(item), cols)
        if col + span > cols:
            col = 0
            row = row + 1
        cells.append((item, pygame.Rect(col * width, top + row * height, span * width, height)))
        col += span
    return cells


def _cross(width: int, line: int) -> Cell:
    """The cross in the top right corner of a panel of that width: two lines of text, for a
    finger.
    """
    return CLOSE, pygame.Rect(width - 2 * line, 0, 2 * line, 2 * line)


def _draw_item(
    surface: pygame.Surface, letters: pygame.font.Font, item: Item, rect: pygame.Rect, lit: bool
) -> None:
    """Draws a picture, the label below it, and below that the key or the slider."""
    line = letters.get_linesize()
    label = drawable(item.label)
    if lit:
        surface.fill(LIT, rect)
        pygame.draw.rect(surface, WHITE, rect, max(1, line // 10), border_radius=line // 4)
    room = rect.inflate(-line // 2, -line // 2)
    while len(label) > 1 and letters.size(label)[0] > room.width:
        label = label[:-2].rstrip() + "…"
    below = bool(item.key) or item.slider is not None
    top = room.bottom - (1 + below) * line
    for words, colour, y in (
        (label, RED if item.warns else WHITE, top),
        (item.key, GREY, top + line),
    ):
        text = letters.render(words, True, colour)
        surface.blit(text, text.get_rect(midtop=(room.centerx, y)))
    if item.slider is not None:
        groove = _groove(rect)
        y = top + line + line // 2
        pygame.draw.line(surface, GREY, (groove.left, y), (groove.right, y), 4)
        pygame.draw.circle(
            surface, WHITE, (groove.left + round(item.slider * groove.width), y), max(5, line // 3)
        )
    if item.picture is not None:
        rows, cols, channels = item.picture.shape
        x, y, *size = fit_area((cols, rows), (room.width, max(1, top - room.top - line // 4)))
        small = cv2.resize(item.picture, size, interpolation=cv2.INTER_AREA).tobytes()
        surface.blit(
            pygame.image.frombuffer(small, size, "RGB" if channels == 3 else "RGBA"),
            (room.left + x, room.top + y),
        )


@lru_cache(1)
def bar_panel(items: tuple[Item, ...], hovered: Event, window_px: Place, text_px: int) -> ItemPanel:
    """The items in rows at the bottom edge, never over the middle. hovered: an event of theirs."""
    width, height = window_px
    spans = sum(map(_span, items))
    for size_px in range(max(BAR_TEXT_PX, min(text_px, width // BAR_LETTERS)), MIN_TEXT_PX - 1, -1):
        letters = font(size_px)
        line = letters.get_linesize()
        widest_px = max(letters.size(item.label)[0] / _span(item) for item in items)
        rows = math.ceil(spans / max(1, int(width / (widest_px + line / 2))))
        cols = math.ceil(spans / rows)
        cells = _cells(items, cols, width // cols, 2 * line + line // 2)
        high = cells[-1][1].bottom
        if high <= BAR_SHARE * height:
            break
    panel = ItemPanel(
        surface=pygame.Surface((width, high), pygame.SRCALPHA), at=(0, height - high), cells=cells
    )
    panel.surface.fill(BACK)
    for item, rect in cells:
        _draw_item(panel.surface, letters, item, rect, item.event == hovered)
    return panel


@lru_cache(2)
def menu_panel(menu: Menu, selected: int, window_px: Place, text_px: int) -> ItemPanel:
    """The page with the selected item, in the middle of a window of that size."""
    width, height = (round(MENU_SHARE * side) for side in window_px)
    letters = font(max(MIN_TEXT_PX, min(round(1.2 * text_px), width // 26)))
    line = letters.get_linesize()
    count = len(menu.items)
    hint = letters.render(menu.hint, True, GREY, None, width - line)
    head_px = hint.get_height() + 3 * line
    least_px = CELL_LINES * line

    def picture_px(cols: int) -> float:
        """Width of a cell's picture where all items are on one page."""
        return min(width // cols, ((height - head_px) // -(-count // cols) - 2 * line) / CELL_SHAPE)

    cols = max(range(1, min(MENU_COLS, count) + 1), key=picture_px)
    if picture_px(cols) < least_px:  # then it has several pages
        cols = max(1, min(MENU_COLS, width // least_px))
    rows = max(1, min((height - head_px) // least_px, -(-count // cols)))
    high = min((height - head_px) // rows, round(CELL_SHAPE * width / cols) + 2 * line)
    page = rows * cols
    first = selected // page * page
    surface = pygame.Surface((width, head_px + rows * high), pygame.SRCALPHA)
    surface.fill(BACK)
    title = letters.render(
        menu.title + (f"   {selected + 1} of {count}" if page < count else ""), True, WHITE
    )
    place = title.get_rect(midtop=(width // 2, line // 2))
    surface.blit(title, place)
    surface.blit(hint, hint.get_rect(midtop=(width // 2, 2 * line)))
    cells = _cells(menu.items[first : first + page], cols, width // cols, high, head_px)
    cells.append(_cross(width, line))
    if page < count:
        lefts = (place.left - 2 * line, place.right)
        cells += [
            (Item(label, Event(key)), pygame.Rect(left, 0, 2 * line, 2 * line - line // 4))
            for (label, key), left in zip(PAGES, lefts, strict=True)  # beside the title
        ]
    for number, (item, rect) in enumerate(cells, first):
        _draw_item(surface, letters, item, rect, number == selected)
    return ItemPanel(
        surface=surface,
        at=((window_px[0] - width) // 2, (window_px[1] - surface.get_height()) // 2),
        cells=cells,
        cols=cols,
        page=page,
    )


@lru_cache(16)
def text_panel(
    text: Overlay, bottom_px: int | None, window_px: Place, text_px: int, top_px: int = EDGE_PX
) -> ItemPanel:
    """The lines of text with a cross, its items and its inset, or else its notices: at the left
    below top_px, or in the middle above bottom_px. Letters are smaller if they do not fit.

    White on black is the same for both eyes, so text lies in the plane of the screen through any
    glasses. The inset is omitted if it does not fit.
    """
    lines = [drawable(line).partition("\t")[::2] for line in text.lines or text.notices]
    columns = list(zip(*lines, strict=True))
    room = [TEXT_SHARE * (side - 2 * EDGE_PX) for side in window_px]
    for size_px in range(text_px, MIN_TEXT_PX - 1, -1):
        letters = font(size_px)
        line = letters.get_linesize()
        before, after = (letters.render("\n".join(column), True, WHITE) for column in columns)
        key_px = letters.size(COLUMN)[0] if any(columns[1]) else 0
        cross_px = 2 * line if text.lines else 0
        width = max(before.get_width(), key_px + after.get_width()) + 2 * PAD_PX + cross_px
        height = before.get_height() + 2 * PAD_PX
        spans = sum(map(_span, text.items))
        widest_px = [letters.size(item.label)[0] // _span(item) for item in text.items]
        cell_px = max(widest_px, default=0) + line
        cells = _cells(text.items, spans, cell_px, 2 * line + line // 2, height)
        if cells:
            width = max(width, spans * cell_px)
            height = cells[-1][1].bottom
        if width <= room[0] and height <= room[1]:
            break
    blits = [(before, (PAD_PX, PAD_PX)), (after, (PAD_PX + key_px, PAD_PX))]
    if text.inset is not None and height + text.inset.shape[0] + PAD_PX <= room[1]:
        inset = pygame.image.frombuffer(text.inset.tobytes(), text.inset.shape[1::-1], "BGR")
        blits.append((inset, (PAD_PX, height)))
        width = max(width, inset.get_width() + 2 * PAD_PX)
        height = height + inset.get_height() + PAD_PX
    surface = pygame.Surface((width, height), pygame.SRCALPHA)
    surface.fill(TEXT_BACK)
    surface.blits(blits)
    if text.lines:
        cells.append(_cross(width, line))
    for item, rect in cells:
        _draw_item(surface, letters, item, rect, False)
    at = (
        (EDGE_PX, top_px)
        if bottom_px is None
        else ((window_px[0] - width) // 2, bottom_px - height - EDGE_PX)
    )
    return ItemPanel(surface=surface, at=at, cells=cells)


@lru_cache(1)
def recording_panel(text: str, window_px: Place, text_px: int) -> ItemPanel:
    """A red dot and text at the top right."""
    letters = font(text_px)
    line = letters.get_linesize()
    words = letters.render(text, True, WHITE)
    surface = pygame.Surface((words.get_width() + 2 * line, line + PAD_PX), pygame.SRCALPHA)
    surface.fill(TEXT_BACK)
    pygame.draw.circle(surface, RED, (line * 3 // 4, surface.get_height() // 2), line // 3)
    surface.blit(words, (line * 3 // 2, PAD_PX // 2))
    return ItemPanel(surface=surface, at=(window_px[0] - surface.get_width() - EDGE_PX, EDGE_PX))


@lru_cache(1)
def progress_panel(share: float, window_px: Place) -> ItemPanel:
    """A thin line along the bottom."""
    line = pygame.Surface((max(1, round(share * window_px[0])), PROGRESS_PX))
    line.fill(WHITE)
    return ItemPanel(surface=line, at=(0, window_px[1] - PROGRESS_PX))


def _action(key: str) -> Event | None:
    return Event(KEY_ACTIONS[key]) if key in KEY_ACTIONS else None


class OverlayView:
    """Draws an overlay, and maps input on it to events."""

    def __init__(self) -> None:
        self._overlay = Overlay()
        self._panels = list[ItemPanel]()
        self._at = 0  # the selected item of the menu
        self._hovered = NO_EVENT  # of the bar
        self._held: Cell | None = None  # a slider
        self._bar_from_s = math.inf  # when the bar appears, for BAR_S
        self._edge_px = 0  # pointer motion below shows the bar or keeps it
        self._menu: ItemPanel | None = None

    def set(self, overlay: Overlay) -> None:
        """Replaces the overlay."""
        old = self._overlay.menu
        menu = overlay.menu
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
        return self._overlay.menu is not None or self._bar_from_s < math.inf

    def panels(self, window_px: Place, text_px: int) -> list[ItemPanel]:
        """The panels, the topmost last; equal calls return the same ones.

        window_px: (width, height).
        """
        overlay = self._overlay
        now_s = time.monotonic()
        bar = bar_panel(overlay.bar, self._hovered, window_px, text_px) if overlay.bar else None
        if bar is None or (now_s > self._bar_from_s + BAR_S and self._held is None):
            self._bar_from_s = math.inf
        # space for the bar stays free, so that nothing moves when it appears
        bar_top_px = window_px[1] if bar is None else bar.at[1]
        pages, panels = list[ItemPanel](), list[ItemPanel]()
        bottom_px = bar_top_px if overlay.menu is None else window_px[1]
        dots = [recording_panel(overlay.recording, window_px, text_px)] if overlay.recording else []
        top_px = EDGE_PX + sum(panel.surface.get_height() + GAP_PX for panel in dots)
        if overlay.lines:
            page = Overlay(lines=overlay.lines, inset=overlay.inset, items=overlay.items)
            pages.append(
                text_panel(page, bar_top_px if overlay.items else None, window_px, text_px, top_px)
            )
            bottom_px = pages[0].at[1] if overlay.items else bottom_px
        for notice in reversed(overlay.notices):
            line = Overlay(notices=tuple(notice.splitlines()))
            panels.append(text_panel(line, bottom_px, window_px, text_px))
            bottom_px = panels[-1].at[1] + EDGE_PX - GAP_PX
        if overlay.progress is not None:
            panels.append(progress_panel(overlay.progress, window_px))
        self._menu = None
        if overlay.menu is not None:
            area_px = window_px[0], min(bar_top_px, bottom_px)
            self._menu = menu_panel(overlay.menu, self._at, area_px, text_px)
            pages.append(self._menu)
        self._edge_px = round((1 - BAR_EDGE) * window_px[1])
        if bar is not None and (now_s >= self._bar_from_s or self._held):
            panels.append(bar)
            self._edge_px = bar_top_px
        self._panels = [*pages, *panels, *dots]
        return self._panels

    def key(self, key: str) -> Event | None:
        """The event of a key: a letter, or a name as "escape"; None if it only moves the
        selection.
        """
        menu = self._overlay.menu
        if key == "escape":
            covered = menu is not None or bool(self._overlay.lines)
            return Event("close" if covered else "leave-fullscreen")
        panel = self._menu
        if menu is None or not menu.items or panel is None:
            return _action(key)
        moves = {
            "left": -1,
            "right": 1,
            "up": -panel.cols,
            "down": panel.cols,
            "pageup": -panel.page,
            "pagedown": panel.page,
        }
        event = menu.items[self._at].event
        if key in moves:
            at = self._at + moves[key]
            count = len(menu.items)
            self._at = at % count if key in ("left", "right") else min(max(at, 0), count - 1)
            return None
        if key == "enter":
            return event
        return Event("delete", event.text) if key == "delete" else _action(key)

    def mouse(self, event: pygame.Event, at_px: Place) -> Event | None:
        """The event of the mouse or a touch. at_px: the pointer."""
        at_once = at_px[1] >= self._edge_px or event.type in PRESSED
        self._bar_from_s = time.monotonic() + (0.0 if at_once else REST_S)
        over = next(filter(None, (panel.cell(at_px) for panel in reversed(self._panels))), None)
        self._hovered = over[0].event if over is not None else NO_EVENT
        if event.type == pygame.MOUSEBUTTONUP:
            self._held = None
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and over is not None:
            item = over[0]
            if item.event.name in ("pageup", "pagedown"):
                return self.key(item.event.name)
            if item.slider is None:
                return item.event
            self._held = over
        if self._held is None:
            return None
        item, rect = self._held
        groove = _groove(rect)
        value = min(max((at_px[0] - groove.left) / groove.width, 0.0), 1.0)
        return attrs.evolve(item.event, value=round(value, 2))
