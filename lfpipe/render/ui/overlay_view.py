"""The overlay in a window: draws its panels, and maps keys, clicks and touches to events.

A panel is a surface with the rectangles of its items, so a click finds what is drawn there. Two
equal calls of a panel's function in a row return the same panel.
"""

import math
import string
import time
from collections.abc import Iterator, Sequence
from functools import lru_cache

import attrs
import cv2

from lfpipe.files.decoding import fit_area
from lfpipe.render.display.display import NO_EVENT, Event, Item, Menu, Overlay
from lfpipe.render.display.painters import Panel
from lfpipe.render.display.window_system import drawable, font, pygame
from lfpipe.render.ui.keys import ACTION_OF, CLOSE, GROUP_OF, LABELS, TIPS
from lfpipe.render.ui.look import (
    ACCENT,
    BORDER,
    CARD,
    CONTROL_UNITS,
    NO_HIGHLIGHT,
    OFF,
    RED,
    SECOND,
    TEXT,
    Highlight,
    Place,
    badge,
    draw_card,
    icon,
    panel_surface,
    unit_px,
)

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
    "i": "open",
    "enter": "enter",
    "left": "less",
    "right": "more",
    "pagedown": "next",
    "pageup": "previous",
}
DIGITS = frozenset(string.digits)
TURNS = Item("◀", Event("pageup")), Item("▶", Event("pagedown"))  # to other pages, as the keys do
PRESSED_OR_NOT = (pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP)
EDGE_PX = 12  # from the window's edge
GAP_PX = 4  # between two notices
MIN_TEXT_PX = 16  # of a line: its letters have 12 px, which are still legible
MIN_MENU_PX = 12  # of a menu in a window below 450 px, where every item must be reachable
COLUMN_UNITS = 4  # between two columns of text
COLUMN_LETTERS = 6  # least width of a column over the height of its lines: two words
# of the window that lines of text may take: the picture below stays visible
TEXT_SHARE = 0.94
HEADING = 1.25  # size of a heading over that of its text
SLIDER_CELLS = 2  # width of a slider over that of an entry: a pixel is about a percent
# Of the window, at most; cells across, at most, and their least size in lines of text: a picture
# says more than its label.
MENU_SHARE, MENU_COLS, CELL_LINES = 0.92, 5, 5
CELL_SHAPE = 0.75  # height over width of a cell's picture, at most: most cameras' views fill it
CHIP_LETTERS = 12  # width of a progress over the size of letters: "measuring depth, 100 %" fits


@attrs.frozen(eq=False, kw_only=True)
class ItemPanel(Panel):
    """A panel with items."""

    cells: list[Cell] = attrs.field(factory=list)
    """Items with their rectangles on the surface."""
    cols: int = 1
    """Columns of a menu."""
    page: int = 1
    """Items of a menu, or lines of text, on one page."""

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

    @property
    def top_px(self) -> int:
        return self.at[1]

    @property
    def bottom_px(self) -> int:
        return self.at[1] + self.surface.get_height()


def _groove(rect: pygame.Rect) -> pygame.Rect:
    """Where a slider moves in its item's rectangle."""
    return rect.inflate(-0.2 * rect.width, 0)


def _draw_slider(surface: pygame.Surface, item: Item, rect: pygame.Rect, y: int, unit: int) -> None:
    groove = _groove(rect)
    at = groove.left + round((item.slider or 0.0) * groove.width)
    line = max(3, unit // 2)
    pygame.draw.line(surface, OFF, (groove.left, y), (groove.right, y), line)
    pygame.draw.line(surface, OFF if item.off else ACCENT, (groove.left, y), (at, y), line)
    pygame.draw.aacircle(surface, SECOND if item.off else TEXT, (at, y), max(6, unit))


def _flow(widths: Sequence[int], room_px: int, height: int, gap: int) -> list[pygame.Rect]:
    """Rectangles of those widths beside each other, in as many rows as they need."""
    rects = list[pygame.Rect]()
    x = y = 0
    for width in widths:
        if x and x + width > room_px:
            x, y = 0, y + height + gap
        rects.append(pygame.Rect(x, y, width, height))
        x += width + gap
    return rects


def _cross(width: int, unit: int) -> Cell:
    """The cross in the top right corner of a panel of that width, for a finger."""
    side = CONTROL_UNITS * unit
    return CLOSE, pygame.Rect(width - side - unit // 2, unit // 2, side, side)


def _draw_button(
    surface: pygame.Surface,
    letters: pygame.font.Font,
    item: Item,
    rect: pygame.Rect,
    lit: Highlight,
    unit: int,
) -> None:
    """A label with its key, or above its slider; without a back if it is a single letter."""
    single = len(item.label) == 1
    is_lit = item.event == lit.event and not item.off
    draw_card(surface, rect, unit, is_lit, lit.pressed, plain=None if single else CARD)
    label = letters.render(drawable(item.label), True, OFF if item.off else TEXT)
    if item.slider is not None:
        surface.blit(label, label.get_rect(midtop=(rect.centerx, rect.top + unit // 2)))
        _draw_slider(surface, item, rect, rect.bottom - 3 * unit // 2, unit)
        return
    key = badge(item.key, letters, unit) if item.key else None
    wide = label.get_width() + (key.get_width() + unit if key else 0)
    place = label.get_rect(midleft=(rect.centerx - wide // 2, rect.centery))
    surface.blit(label, place)
    if key is not None:
        surface.blit(key, key.get_rect(midleft=(place.right + unit, rect.centery)))


def _button_px(item: Item, letters: pygame.font.Font, unit: int) -> int:
    """The width of a button."""
    key = badge(item.key, letters, unit).get_width() + unit if item.key else 0
    return max(letters.size(item.label)[0] + key + 3 * unit, 18 * unit * (item.slider is not None))


# The bar: icons beside their labels, over them, or alone, the first that fits.
BESIDE, OVER, ALONE = range(3)
ICON_SHARE = 0.6  # of the usual place of an icon, at least: still larger than a fingertip needs


def _bar_px(item: Item, style: int, letters: pygame.font.Font, unit: int) -> int:
    """The width of an entry in all its states."""
    side = CONTROL_UNITS * unit
    label = max(letters.size(text)[0] for text in LABELS[item.event.name])
    if item.slider is not None:
        return SLIDER_CELLS * side + unit if style == ALONE else max(3 * side, label)
    return (label + 6 * unit, max(side, label + 2 * unit), side)[style]


@lru_cache(2)
def bar_panel(items: tuple[Item, ...], lit: Highlight, window_px: Place, text_px: int) -> ItemPanel:
    """The items at the bottom edge, in groups."""
    room = window_px[0] - 2 * EDGE_PX
    letters = font(text_px)
    unit = unit_px(text_px)
    starts = [
        k > 0 and GROUP_OF[item.event.name] != GROUP_OF[items[k - 1].event.name]
        for k, item in enumerate(items)
    ]
    for style in (BESIDE, OVER, ALONE):
        widths = [_bar_px(item, style, letters, unit) for item in items]
        rest = room - 2 * unit * (1 + sum(starts))
        if sum(widths) <= rest:
            break
    squeezed = min(1.0, max(ICON_SHARE, rest / sum(widths)))
    widths = [int(squeezed * width) for width in widths]
    side = int(squeezed * CONTROL_UNITS * unit) + (style == OVER) * unit
    cells = list[Cell]()
    lines = list[pygame.Rect]()
    x = y = unit
    for item, wide, begins in zip(items, widths, starts, strict=True):
        if begins:
            lines.append(pygame.Rect(x + unit - 1, y + unit, max(1, unit // 8), side - 2 * unit))
            x += 2 * unit
        if x + wide > room - unit:
            x, y = unit, y + side
        cells.append((item, pygame.Rect(x, y, wide, side)))
        x += wide
    width = max(rect.right for _, rect in cells) + unit
    surface = panel_surface(width, y + side + unit, unit)
    for line in lines:
        surface.fill(BORDER, line)
    for item, rect in cells:
        _draw_entry(surface, letters, item, rect, lit, style, unit)
    at = ((window_px[0] - width) // 2, window_px[1] - surface.get_height() - EDGE_PX)
    return ItemPanel(surface=surface, at=at, cells=cells)


def _draw_entry(
    surface: pygame.Surface,
    letters: pygame.font.Font,
    item: Item,
    rect: pygame.Rect,
    lit: Highlight,
    style: int,
    unit: int,
) -> None:
    """An entry of the bar: an icon or a slider, and its label."""
    is_lit = item.event == lit.event and not item.off
    draw_card(surface, rect, unit, is_lit, lit.pressed, plain=None)
    colour = RED if item.warns else TEXT
    if item.off:
        colour = OFF
    label = letters.render(item.label, True, colour)
    middle = rect.centery if style == ALONE else rect.top + 2 * unit
    if item.slider is not None:
        _draw_slider(surface, item, rect, middle, unit)
    else:
        drawing = icon(item.event.name, 11 * unit // 4, colour)
        if style == BESIDE:
            surface.blit(drawing, drawing.get_rect(midleft=(rect.left + unit, rect.centery)))
            surface.blit(label, label.get_rect(midleft=(rect.left + 9 * unit // 2, rect.centery)))
        else:
            surface.blit(drawing, drawing.get_rect(center=(rect.centerx, middle)))
    if style == OVER or (style == BESIDE and item.slider is not None):
        surface.blit(label, label.get_rect(midbottom=(rect.centerx, rect.bottom - unit // 2)))


@lru_cache(1)
def tip_panel(item: Item, over: tuple[int, int], window_px: Place, text_px: int) -> ItemPanel:
    """What an entry of the bar does, and its key. over: the middle of its upper edge."""
    letters, unit = font(text_px), unit_px(text_px)
    text = letters.render(f"{item.label}: {TIPS[item.event.name]}", True, TEXT)
    key = badge(item.key, letters, unit) if item.key else pygame.Surface((0, 0))
    width = text.get_width() + key.get_width() + 3 * unit
    surface = panel_surface(width, 5 * unit, unit)
    surface.blit(text, text.get_rect(midleft=(unit, surface.get_height() // 2)))
    surface.blit(key, key.get_rect(midright=(width - unit, surface.get_height() // 2)))
    x = min(max(over[0] - width // 2, EDGE_PX), max(EDGE_PX, window_px[0] - EDGE_PX - width))
    return ItemPanel(surface=surface, at=(x, over[1] - surface.get_height() - unit))


@lru_cache(2)
def menu_panel(
    menu: Menu,
    selected: int,
    window_px: Place,
    text_px: int,
    lit: Highlight = NO_HIGHLIGHT,
    top_px: int = 0,
) -> ItemPanel:
    """The page with the selected item, in the middle of a window of that size, below top_px."""
    width, height = (round(MENU_SHARE * side) for side in (window_px[0], window_px[1] - top_px))
    text_px = max(MIN_MENU_PX, min(text_px, width // 26))
    letters, unit = font(text_px), unit_px(text_px)
    line = letters.get_linesize()
    count = len(menu.items)
    pad = 2 * unit
    title = font(round(HEADING * text_px)).render(drawable(menu.title), True, TEXT)
    number = f"{selected + 1} of {count}"
    side = CONTROL_UNITS * unit
    hint = letters.render(menu.hint, True, SECOND, None, width - 2 * pad)
    head_px = pad + max(title.get_height(), side - unit) + hint.get_height() + unit
    least_px = CELL_LINES * line
    room = width - 2 * pad + unit, height - head_px - pad + unit

    def picture_px(cols: int) -> float:
        """Width of a cell's picture where all items are on one page."""
        return min(room[0] // cols, (room[1] // -(-count // cols) - 3 * line) / CELL_SHAPE)

    cols = max(range(1, min(MENU_COLS, count) + 1), key=picture_px)
    if picture_px(cols) < least_px:  # then it has several pages
        cols = max(1, min(MENU_COLS, room[0] // least_px))
    rows = max(1, min(room[1] // least_px, -(-count // cols)))
    wide = room[0] // cols
    high = max(min(room[1] // rows, round(CELL_SHAPE * wide) + 3 * line), line + 3 * unit)
    page = rows * cols
    first = selected // page * page
    surface = panel_surface(width, head_px + rows * high - unit + pad, unit)
    surface.blit(title, (pad, pad))
    surface.blit(hint, (pad, head_px - hint.get_height() - unit))
    shown = menu.items[first : first + page]
    cells = [
        (
            item,
            pygame.Rect(
                pad + k % cols * wide, head_px + k // cols * high, wide - unit, high - unit
            ),
        )
        for k, item in enumerate(shown)
    ]
    for k, (item, rect) in enumerate(cells, first):
        _draw_tile(surface, letters, item, rect, lit, k == selected, unit)
    buttons = [_cross(width, unit)]
    if page < count:
        x = min(pad + title.get_width() + unit, width - 4 * side - letters.size(number)[0])
        words = letters.render(number, True, SECOND)
        places = (x, x + side + words.get_width() + 2 * unit)
        surface.blit(words, words.get_rect(midleft=(x + side + unit, buttons[0][1].centery)))
        buttons += [
            (turn, pygame.Rect(left, unit // 2, side, side))
            for turn, left in zip(TURNS, places, strict=True)
        ]
    for item, rect in buttons:
        _draw_button(surface, letters, item, rect, lit, unit)
    return ItemPanel(
        surface=surface,
        at=(
            (window_px[0] - width) // 2,
            (window_px[1] + top_px - surface.get_height()) // 2,
        ),
        cells=[*cells, *buttons],
        cols=cols,
        page=page,
    )


def _draw_tile(
    surface: pygame.Surface,
    letters: pygame.font.Font,
    item: Item,
    rect: pygame.Rect,
    lit: Highlight,
    focused: bool,
    unit: int,
) -> None:
    """A card with a picture and below it the label, in at most two lines: of a longer one, both
    ends, because names of files often differ at the end.
    """
    draw_card(surface, rect, unit, item.event == lit.event, lit.pressed, focused)
    room = rect.inflate(-2 * unit, -2 * unit)
    whole = label = drawable(item.label)
    kept = len(whole)
    while kept > 2 and letters.size(label)[0] > 2 * room.width - 4 * unit:
        kept -= 1
        label = f"{whole[: kept - kept // 2]}…{whole[-(kept // 2) :]}"
    letters.align = pygame.FONT_CENTER
    text = letters.render(label, True, TEXT, None, max(1, room.width))
    letters.align = pygame.FONT_LEFT
    text = text.subsurface((0, 0, text.get_width(), min(text.get_height(), room.height)))
    surface.blit(text, text.get_rect(midbottom=room.midbottom))
    space = room.width, max(1, room.height - text.get_height() - unit)
    if item.icon:
        drawing = icon(item.icon, min(space) // 2, TEXT)
        surface.blit(drawing, drawing.get_rect(center=(room.centerx, room.top + space[1] // 2)))
    if item.picture is not None:
        rows, cols, channels = item.picture.shape
        x, y, *size = fit_area((cols, rows), space)
        small = cv2.resize(item.picture, size, interpolation=cv2.INTER_AREA).tobytes()
        surface.blit(
            pygame.image.frombuffer(small, size, "RGB" if channels == 3 else "RGBA"),
            (room.left + x, room.top + y),
        )


def _block(
    lines: Sequence[str], letters: pygame.font.Font, key_px: int, room_px: int
) -> pygame.Surface:
    """Lines below each other: those with a tab have a key, and a line before them is a heading."""
    unit = unit_px(letters.get_linesize())
    has_keys = any("\t" in line for line in lines)
    rows = list[tuple[pygame.Surface | None, pygame.Surface]]()
    for line in lines:
        key, tab, words = drawable(line).rpartition("\t")
        colour = SECOND if has_keys and not tab else TEXT
        text = letters.render(words, True, colour, None, max(1, room_px - key_px))
        rows.append((badge(key, letters, unit) if key else None, text))
    gap = unit // 4
    heights = [max(text.get_height(), key.get_height() if key else 0) + gap for key, text in rows]
    width = max(text.get_width() + (key_px if key else 0) for key, text in rows)
    surface = pygame.Surface((width, sum(heights)), pygame.SRCALPHA)
    y = 0
    for (drawn, text), height in zip(rows, heights, strict=True):
        middle = y + (height - gap) // 2
        if drawn is not None:
            surface.blit(drawn, drawn.get_rect(midleft=(0, middle)))
        surface.blit(text, text.get_rect(midleft=(key_px if drawn else 0, middle)))
        y += height
    return surface


def _columns(blocks: Sequence[pygame.Surface], cols: int, unit: int) -> list[pygame.Rect]:
    """The places of blocks in one column or two of about the same height."""
    gap = 2 * unit
    half = sum(block.get_height() + gap for block in blocks) / cols
    rects = list[pygame.Rect]()
    x = y = 0
    for block in blocks:
        if y and y + block.get_height() / 2 > half:
            x, y = max(rect.right for rect in rects) + COLUMN_UNITS * unit, 0
        rects.append(block.get_rect(topleft=(x, y)))
        y += block.get_height() + gap
    return rects


def _attempts(
    lines: tuple[str, ...], text_px: int, first: int
) -> Iterator[tuple[int, int, tuple[str, ...]]]:
    """The size of letters, the number of columns, and the lines, in the order of trials: all lines,
    smaller and smaller, then a part of the keys, beginning with the line `first`.
    """
    if not first:
        for size_px in range(text_px, MIN_TEXT_PX - 1, -1):
            for cols in (1, 2) if "" in lines else (1,):
                yield size_px, cols, lines
    if "" in lines:
        for count in range(len(lines) - first, 0, -1):
            yield MIN_TEXT_PX, 1, lines[first : first + count]


@lru_cache(16)
def text_panel(
    text: Overlay,
    bottom_px: int,
    window_px: Place,
    text_px: int,
    top_px: int = EDGE_PX,
    lit: Highlight = NO_HIGHLIGHT,
    first: int = 0,
) -> ItemPanel:
    """The lines of text with a cross, its items and its inset, or else its notices, between top_px
    and bottom_px: at the left, in the middle if the lines have keys, and at the bottom if there are
    items or notices. Letters are smaller if they do not fit. Then keys are on several pages; first:
    the line that this one begins with.

    White on black is the same for both eyes, so text lies in the plane of the screen through any
    glasses. The inset is omitted if it does not fit.
    """
    lines = text.lines or text.notices
    has_keys = any("\t" in line for line in lines)
    at_bottom = not text.lines or bool(text.items)
    room = TEXT_SHARE * (window_px[0] - 2 * EDGE_PX), bottom_px - top_px - EDGE_PX
    for size_px, cols, shown in _attempts(lines, text_px, first):
        sections = [part.split("\n") for part in "\n".join(shown).strip("\n").split("\n\n")]
        items = (*text.items, *(TURNS if len(shown) < len(lines) else ()))
        letters, unit = font(size_px), unit_px(size_px)
        pad = 2 * unit if text.lines else unit
        cross_px = CONTROL_UNITS * unit if text.lines else 0
        keys = [line.partition("\t")[0] for line in lines if "\t" in line]
        key_px = max((badge(key, letters, unit).get_width() for key in keys), default=-unit) + unit
        wrap_px = int(room[0] - 2 * pad - cross_px - (cols - 1) * COLUMN_UNITS * unit) // cols
        wrap_px = max(wrap_px, key_px + COLUMN_LETTERS * size_px)
        blocks = [_block(part, letters, key_px, wrap_px) for part in sections]
        places = _columns(blocks, cols, unit)
        body = pygame.Rect.unionall(places[0], places[1:])
        width = body.width + 2 * pad + cross_px
        height = max(body.height, cross_px - unit) + 2 * pad
        widths = [_button_px(item, letters, unit) for item in items]
        rects = _flow(widths, round(room[0] - 2 * pad), CONTROL_UNITS * unit, unit)
        if rects:
            row = pygame.Rect.unionall(rects[0], rects[1:])
            width, height = max(width, row.width + 2 * pad), height + row.height + unit
        if width <= room[0] and height <= room[1]:
            break
    top = pad + (max(body.height, cross_px - unit) - body.height) // 2
    blits = [(block, place.move(pad, top)) for block, place in zip(blocks, places, strict=True)]
    cells = [
        (item, rect.move(pad, height - pad - row.height))
        for item, rect in zip(items, rects, strict=True)
    ]
    if text.inset is not None and height + text.inset.shape[0] + pad <= room[1]:
        inset = pygame.image.frombuffer(text.inset.tobytes(), text.inset.shape[1::-1], "BGR")
        blits.append((inset, inset.get_rect(topleft=(pad, height))))
        width = max(width, inset.get_width() + 2 * pad)
        height = height + inset.get_height() + pad
    surface = panel_surface(width, height, unit)
    surface.blits(blits)
    if text.lines:
        cells.append(_cross(width, unit))
    for item, rect in cells:
        _draw_button(surface, letters, item, rect, lit, unit)
    x = (window_px[0] - width) // 2 if has_keys or at_bottom else EDGE_PX
    middle = top_px + max(0, room[1] - height) // 2 if has_keys else top_px
    at = x, bottom_px - height - EDGE_PX if at_bottom else middle
    return ItemPanel(surface=surface, at=at, cells=cells, page=len(shown))


@lru_cache(2)
def scene_panel(
    name: str, step: str, share: float | None, window_px: Place, text_px: int
) -> ItemPanel:
    """The scene's name at the top left, and what is being done with it."""
    letters, unit = font(text_px), unit_px(text_px)
    words = letters.render(drawable(name), True, TEXT)
    below = letters.render(step, True, SECOND) if step else None
    width = words.get_width()
    height = words.get_height() + 2 * unit
    if below is not None:
        width = max(width, below.get_width(), CHIP_LETTERS * text_px)
        height += below.get_height() + 3 * unit // 2
    width = min(width, window_px[0] - 2 * EDGE_PX - 3 * unit)
    surface = panel_surface(width + 3 * unit, height, unit)
    surface.blit(words, (3 * unit // 2, unit), (0, 0, width, height))
    if below is not None:
        surface.blit(below, (3 * unit // 2, unit + words.get_height()), (0, 0, width, height))
        groove = pygame.Rect(3 * unit // 2, height - 3 * unit // 2, width, max(3, unit // 2))
        pygame.draw.rect(surface, OFF, groove, border_radius=unit // 4)
        groove.width = round((share or 0.0) * width)
        pygame.draw.rect(surface, ACCENT, groove, border_radius=unit // 4)
    return ItemPanel(surface=surface, at=(EDGE_PX, EDGE_PX))


@lru_cache(4)
def dot_panel(
    text: str, colour: tuple[int, int, int], top_px: int, window_px: Place, text_px: int
) -> ItemPanel:
    """A dot and text at the top right."""
    letters, unit = font(text_px), unit_px(text_px)
    words = letters.render(text, True, TEXT)
    radius = unit // 2 + 1
    surface = panel_surface(words.get_width() + 5 * unit, words.get_height() + 2 * unit, unit)
    pygame.draw.aacircle(surface, colour, (2 * unit, surface.get_height() // 2), radius)
    pygame.draw.circle(surface, colour, (2 * unit, surface.get_height() // 2), radius - 1)
    surface.blit(words, (7 * unit // 2, unit))
    return ItemPanel(surface=surface, at=(window_px[0] - surface.get_width() - EDGE_PX, top_px))


def _action(key: str) -> Event | None:
    return Event(KEY_ACTIONS[key]) if key in KEY_ACTIONS else None


class OverlayView:
    """Draws an overlay, and maps input on it to events."""

    def __init__(self) -> None:
        self._overlay = Overlay()
        self._panels = list[ItemPanel]()
        self._at = 0  # the selected item of the menu
        self._lit = NO_HIGHLIGHT
        self._over: Cell | None = None  # what the pointer is on
        self._used = NO_EVENT  # pressed, and the pointer is still there: it needs no tip
        self._held: Cell | None = None  # a slider
        self._bar_from_s = math.inf  # when the bar appears, for BAR_S
        self._edge_px = 0  # pointer motion below shows the bar or keeps it
        self._menu: ItemPanel | None = None
        self._lines = 0  # of text, on the page that is shown
        self._firsts = [0]  # the first lines of the pages of text up to the one that is shown

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
        if overlay.lines != self._overlay.lines:
            self._firsts, self._lines = [0], len(overlay.lines)
        self._overlay = overlay

    @property
    def has_pointer(self) -> bool:
        """Whether the pointer has a target."""
        has_items = self._overlay.menu is not None or bool(self._overlay.items)
        return has_items or self._bar_from_s < math.inf

    def _highlight_of(self, *items: Item) -> Highlight:
        """What is lit of some items: the others need not be drawn again."""
        return self._lit if any(item.event == self._lit.event for item in items) else NO_HIGHLIGHT

    def panels(self, window_px: Place, text_px: int) -> list[ItemPanel]:
        """The panels, the topmost last; equal calls return the same ones.

        window_px: (width, height).
        """
        overlay = self._overlay
        now_s = time.monotonic()
        bar = None
        if overlay.bar:
            bar = bar_panel(overlay.bar, self._highlight_of(*overlay.bar), window_px, text_px)
        if bar is None or (now_s > self._bar_from_s + BAR_S and self._held is None):
            self._bar_from_s = math.inf
        is_awake = bar is not None and (now_s >= self._bar_from_s or self._held is not None)
        # space for the bar stays free, so that nothing moves when it appears
        bar_top_px = bottom_px = window_px[1] if bar is None else bar.top_px
        corners = self._corners(is_awake, window_px, text_px)
        pages, notices = list[ItemPanel](), list[ItemPanel]()
        if overlay.lines:
            page = Overlay(lines=overlay.lines, inset=overlay.inset, items=overlay.items)
            top_px = EDGE_PX
            if not overlay.items:
                top_px = max((corner.bottom_px + GAP_PX for corner in corners), default=EDGE_PX)
            lit = self._highlight_of(CLOSE, *overlay.items, *TURNS)
            place = bar_top_px, window_px, text_px, top_px
            pages.append(text_panel(page, *place, lit, self._firsts[-1]))
            self._lines = pages[0].page
            bottom_px = pages[0].top_px if overlay.items else bottom_px
        items = () if overlay.lines else overlay.items
        for notice in reversed(overlay.notices):
            line = Overlay(notices=tuple(notice.splitlines()), items=items)
            lit = self._highlight_of(*items)
            notices.append(text_panel(line, bottom_px, window_px, text_px, lit=lit))
            items = ()
            bottom_px = notices[-1].top_px + EDGE_PX - GAP_PX
        self._menu = None
        if overlay.menu is not None:
            area_px = window_px[0], min(bar_top_px, bottom_px)
            lit = self._highlight_of(CLOSE, *TURNS, *overlay.menu.items)
            corners = corners[:1] if overlay.recording else []
            top_px = max((corner.bottom_px for corner in corners), default=0)
            self._menu = menu_panel(overlay.menu, self._at, area_px, text_px, lit, top_px)
            pages.append(self._menu)
        self._edge_px = round((1 - BAR_EDGE) * window_px[1])
        bars = list[ItemPanel]()
        if bar is not None and is_awake:
            bars.append(bar)
            self._edge_px = bar_top_px
            is_new = self._over is not None and self._over[0].event != self._used
            if self._over is not None and is_new and self._over[0].event.name in TIPS:
                item, rect = self._over
                item = next(one for one in overlay.bar if one.event.name == item.event.name)
                bars.append(tip_panel(item, (rect.centerx, bar_top_px), window_px, text_px))
        self._panels = [*pages, *notices, *corners, *bars]
        return self._panels

    def _corners(self, is_awake: bool, window_px: Place, text_px: int) -> list[ItemPanel]:
        """The recording, the viewer and the scene in the upper corners."""
        overlay = self._overlay
        panels = list[ItemPanel]()
        for text, colour in ((overlay.recording, RED), (overlay.viewer * is_awake, ACCENT)):
            if text:
                top_px = panels[-1].bottom_px + GAP_PX if panels else EDGE_PX
                panels.append(dot_panel(text, colour, top_px, window_px, text_px))
        if overlay.step or (overlay.scene and is_awake):
            step = overlay.step, overlay.progress
            panels.append(scene_panel(overlay.scene, *step, window_px, text_px))
        return panels

    def key(self, key: str) -> Event | None:
        """The event of a key: a letter, or a name as "escape"; None if it only moves the
        selection.
        """
        menu = self._overlay.menu
        if key == "escape":
            covered = menu is not None or bool(self._overlay.lines)
            return Event("close" if covered else "leave-fullscreen")
        if self._overlay.types and (key in DIGITS or key == "backspace"):
            return Event("type", key)
        first, count = self._firsts[-1], len(self._overlay.lines)
        if menu is None and self._lines < count and key in ("pageup", "pagedown"):
            if key == "pageup":
                self._firsts = self._firsts[:-1] or [0]
            elif first + self._lines < count:
                self._firsts.append(first + self._lines)
            return None
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
        if event.type == pygame.MOUSEWHEEL:
            if self._menu is None:
                return None
            return self.key("pageup" if event.y > 0 else "pagedown") or NO_EVENT
        at_once = at_px[1] >= self._edge_px or event.type in PRESSED_OR_NOT
        self._bar_from_s = time.monotonic() + (0.0 if at_once else REST_S)
        self._over = next(
            filter(None, (panel.cell(at_px) for panel in reversed(self._panels))), None
        )
        lit = self._over[0].event if self._over is not None else NO_EVENT
        is_down = event.type == pygame.MOUSEBUTTONDOWN or (
            self._lit.pressed and event.type == pygame.MOUSEMOTION
        )
        self._lit = Highlight(lit, is_down) if lit.name else NO_HIGHLIGHT
        if is_down or lit != self._used:
            self._used = lit if is_down else NO_EVENT
        if event.type == pygame.MOUSEBUTTONUP:
            self._held = None
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and self._over is not None:
            item = self._over[0]
            if item.off:
                return NO_EVENT
            if item.event.name in ("pageup", "pagedown"):
                return self.key(item.event.name)
            if item.slider is None:
                return item.event
            self._held = self._over
        if self._held is None:
            return None
        item, rect = self._held
        groove = _groove(rect)
        value = min(max((at_px[0] - groove.left) / groove.width, 0.0), 1.0)
        return attrs.evolve(item.event, value=round(value, 2))
