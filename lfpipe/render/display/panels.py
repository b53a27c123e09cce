"""The panels of the overlay in a window.

A panel is a surface with the rectangles of its items, so a click finds what is drawn there. Two
equal calls of a panel's function in a row return the same panel.
"""

from collections.abc import Sequence
from functools import lru_cache
from itertools import product

import attrs

from lfpipe.render.display import ACCENT, OFF, SECOND, TEXT
from lfpipe.render.display.display import (
    CLOSE,
    GROUP_OF,
    LABELS,
    USED,
    Event,
    Item,
    Menu,
    Notice,
    Overlay,
)
from lfpipe.render.display.look import (
    BORDER,
    CARD,
    CONTROL_UNITS,
    NO_HIGHLIGHT,
    Highlight,
    Point,
    badge,
    button_rects,
    draw_button,
    draw_entry,
    draw_row,
    draw_tile,
    pages_of,
    panel_surface,
    shortened,
    unit_px,
)
from lfpipe.render.display.window_system import drawable, font, pygame, written

Cell = tuple[Item, pygame.Rect]
TURNS = Item("◀", Event("pageup")), Item("▶", Event("pagedown"))  # to other pages, as the keys do
EDGE_PX = 16  # from the window's edge
GAP_PX = 8  # between two panels
SMALLEST_TEXT_PX = 11  # where a small window shows all keys, or every item of a menu
COLUMN_UNITS = 4  # between two columns of text
COLUMN_LETTERS = 6  # least width of a column over the height of its lines: two words
TEXT_SHARE = 0.94  # of the window that pages may take: the picture below stays visible
HEADING = 1.25  # size of a title over that of its text
SLIDER_CELLS = 2  # width of a slider over that of an entry: a pixel is about a percent
# Over the size of letters, the least width of a tile, the width of a menu of rows, and that of a
# bar of a value
TILE_LETTERS, ROW_LETTERS, VALUE_LETTERS = 9, 26, 8
TILE_SHAPE = 0.75  # height over width of a tile's picture: most cameras' views fill it
CHIP_LETTERS = 12  # width of a progress over the size of letters: "measuring depth, 100 %" fits
CAPTION = 1.6  # letters of a caption over others: visitors stand two metres away


@attrs.frozen(eq=False, kw_only=True)
class Panel:
    """A drawn surface over the picture, with items; a painter keeps what it derives from one."""

    surface: pygame.Surface
    at: Point
    """Its top left corner in the window, px."""
    cells: list[Cell] = attrs.field(factory=list)
    """Items with their rectangles on the surface."""
    rects: dict[int, pygame.Rect] = attrs.field(factory=dict)
    """Of a menu, the rectangles of its items by number."""
    bare: frozenset[str] = frozenset()
    """Names of a bar's entries without words."""

    def cell(self, place: Point) -> Cell | None:
        """The item at a place of the window, and its rectangle in the window."""
        cells = ((item, rect.move(self.at)) for item, rect in self.cells)
        return next((cell for cell in cells if cell[1].collidepoint(place)), None)

    @property
    def rect(self) -> pygame.Rect:
        """Its place in the window."""
        return self.surface.get_rect(topleft=self.at)


def _cross(width: int, unit: int) -> Cell:
    """The cross in the top right corner of a panel of that width, for a finger."""
    side = CONTROL_UNITS * unit
    return CLOSE, pygame.Rect(width - side - unit // 2, unit // 2, side, side)


ICON_SHARE = 0.6  # of the usual place of an icon, at least: still larger than a fingertip needs


def _bar_px(item: Item, worded: bool, beside: bool, text_px: int, unit: int) -> int:
    """The width of an entry in all its states."""
    side = CONTROL_UNITS * unit
    label = max(font(text_px).size(text)[0] for text in LABELS[item.event.name]) * worded
    if item.slider is not None:
        return label * beside + max(SLIDER_CELLS * side + unit, label)
    return label + 6 * unit if beside else max(side, label + 2 * unit)


@lru_cache(2)
def bar_panel(items: tuple[Item, ...], lit: Highlight, window_px: Point, text_px: int) -> Panel:
    """The items at the bottom edge, in groups: icons beside their words, else over them; words of
    as many as fit, beginning with the most used ones.
    """
    room = window_px[0] - 2 * EDGE_PX
    unit = unit_px(text_px)
    starts = [
        k > 0 and GROUP_OF[item.event.name] != GROUP_OF[items[k - 1].event.name]
        for k, item in enumerate(items)
    ]
    free_px = room - 2 * unit * (1 + sum(starts))
    for words in (USED, *(USED[:count] for count in range(len(USED), -1, -1))):
        beside = words is USED
        worded = [item.event.name in words for item in items]
        widths = [
            _bar_px(item, word, beside, text_px, unit)
            for item, word in zip(items, worded, strict=True)
        ]
        if sum(widths) <= free_px:
            break
    share = min(1.0, max(ICON_SHARE, free_px / sum(widths)))
    widths = [int(share * width) for width in widths]
    side = int(share * CONTROL_UNITS * unit) + (any(worded) and not beside) * unit
    cells = list[Cell]()
    lines = list[pygame.Rect]()
    x = y = unit
    for item, wide, begins in zip(items, widths, starts, strict=True):
        if begins:
            lines.append(pygame.Rect(x + unit - 1, y + unit, max(1, unit // 8), side - 2 * unit))
            x += 2 * unit
        if x + wide > room - unit:
            x, y = unit, y + side
        label_px = font(text_px).size(item.label)[0] * (beside and item.slider is not None)
        cells.append((item, pygame.Rect(x + label_px, y, wide - label_px, side)))
        x += wide
    width = max(rect.right for _, rect in cells) + unit
    surface = panel_surface(width, y + side + unit, unit)
    for line in lines:
        surface.fill(BORDER, line)
    for (item, rect), word in zip(cells, worded, strict=True):
        draw_entry(surface, text_px, item, rect, lit, word, beside, unit)
    return Panel(
        surface=surface,
        at=((window_px[0] - width) // 2, window_px[1] - surface.get_height() - EDGE_PX),
        cells=cells,
        bare=frozenset(item.event.name for item in items) - set(words),
    )


@lru_cache(2)
def tip_panel(item: Item, over: tuple[int, int], window_px: Point, text_px: int) -> Panel:
    """The name of an entry of the bar and its key, or why it is off. over: the middle of its upper
    edge.
    """
    tip = item.label + f" ({item.key})" * bool(item.key) + f": {item.more}" * item.off
    panel = notice_panel(Notice(tip), over[1] - GAP_PX, False, window_px, text_px)
    most_px = window_px[0] - EDGE_PX - panel.rect.width
    x = min(max(over[0] - panel.rect.width // 2, EDGE_PX), most_px)
    return attrs.evolve(panel, at=(x, panel.rect.top))


@lru_cache(2)
def menu_panel(
    menu: Menu,
    selected: int,
    window_px: Point,
    text_px: int,
    lit: Highlight = NO_HIGHLIGHT,
    top_px: int = 0,
) -> Panel:
    """The page with the selected item, in the middle of a window of that size, below top_px. Tiles
    have the same size and places, however many there are.
    """
    width, height = (round(TEXT_SHARE * side) for side in (window_px[0], window_px[1] - top_px))
    text_px = max(SMALLEST_TEXT_PX, min(text_px, width // 26))
    unit = unit_px(text_px)
    if all(item.row for item in menu.items):
        width = min(width, ROW_LETTERS * text_px)
    pad, side = 2 * unit, CONTROL_UNITS * unit
    title = written(menu.title, round(HEADING * text_px), TEXT, True)
    head_px = unit // 2 + side + unit // 2
    room = width - 2 * pad, max(height - head_px - pad, 1)
    cols = max(1, (room[0] + unit) // (TILE_LETTERS * text_px + unit))
    wide = (room[0] + unit) // cols - unit
    least_px = side if room[1] > 3 * side else font(text_px).get_linesize() + unit
    tile_px = wide, min(room[1], round(TILE_SHAPE * wide) + 2 * text_px + 3 * unit)
    sizes = (
        (room[0], least_px if item.event.name else 2 * least_px // 3) if item.row else tile_px
        for item in menu.items
    )
    pages = pages_of(sizes, room, unit)
    placed = [(number, rect) for number, page in enumerate(pages) for rect in page]
    page, _ = placed[selected]
    rects = {
        number: rect.move(pad, head_px) for number, (at, rect) in enumerate(placed) if at == page
    }
    used_px = max(rect.bottom for rect in pages[0]) if len(pages) == 1 else room[1]
    surface = panel_surface(width, head_px + used_px + pad, unit)
    surface.blit(title, title.get_rect(midleft=(pad, unit // 2 + side // 2)))
    for number, rect in rects.items():
        draw = draw_row if menu.items[number].row else draw_tile
        draw(surface, text_px, menu.items[number], rect, lit, number == selected, unit)
    buttons = [_cross(width, unit)]
    if len(pages) > 1:
        words = written(f"{page + 1} / {len(pages)}", text_px, SECOND)
        x = buttons[0][1].left - 2 * side - words.get_width() - unit
        surface.blit(words, words.get_rect(midleft=(x + side, buttons[0][1].centery)))
        buttons += [
            (turn, pygame.Rect(left, unit // 2, side, side))
            for turn, left in zip(TURNS, (x, x + side + words.get_width()), strict=True)
        ]
    for item, rect in buttons:
        draw_button(surface, text_px, item, rect, lit, unit)
    cells = [(menu.items[k], rect) for k, rect in rects.items() if menu.items[k].event.name]
    x, y = ((size - side) // 2 for size, side in zip(window_px, surface.get_size(), strict=True))
    return Panel(surface=surface, at=(x, y + top_px // 2), cells=[*cells, *buttons], rects=rects)


def _block(lines: Sequence[str], text_px: int, key_px: int, room_px: int) -> pygame.Surface:
    """Lines below each other: those with a tab have a key, those with two tabs a value with its
    bar, and a line before them is a heading.
    """
    unit = unit_px(text_px)
    gap = unit // 2
    has_keys = any("\t" in line for line in lines)
    rows = list[tuple[pygame.Surface | None, pygame.Surface]]()
    for line in lines:
        key, *words = drawable(line).split("\t")
        wrap_px = max(1, room_px - key_px)
        match words:
            case [amount, share]:
                rows.append(
                    (written(key, text_px, SECOND), _value(amount, float(share), text_px, unit))
                )
            case [what]:
                rows.append(
                    (badge(key, text_px, unit), written(what, text_px, TEXT, wrap_px=wrap_px))
                )
            case _:
                colour = ACCENT if has_keys else TEXT
                rows.append((None, written(key, text_px, colour, has_keys, wrap_px)))
    heights = [max(text.get_height(), key.get_height() if key else 0) + gap for key, text in rows]
    width = max(text.get_width() + (key_px if key else 0) for key, text in rows)
    surface = pygame.Surface((width, sum(heights)), pygame.SRCALPHA)
    y = 0
    for (left, text), height in zip(rows, heights, strict=True):
        middle = y + (height - gap) // 2
        if left is not None:
            surface.blit(left, left.get_rect(midleft=(0, middle)))
        surface.blit(text, text.get_rect(midleft=(key_px if left else 0, middle)))
        y += height
    return surface


def _value(text: str, share: float, text_px: int, unit: int) -> pygame.Surface:
    """A bar of that share, and a value."""
    words = written(text, text_px, TEXT)
    bar = pygame.Rect(0, (words.get_height() - unit) // 2, VALUE_LETTERS * text_px, unit)
    surface = pygame.Surface(
        (bar.width + 2 * unit + words.get_width(), words.get_height()), pygame.SRCALPHA
    )
    pygame.draw.rect(surface, CARD, bar, border_radius=unit // 2)
    bar.width = round(min(max(share, 0.0), 1.0) * bar.width)
    pygame.draw.rect(surface, ACCENT, bar, border_radius=unit // 2)
    surface.blit(words, (VALUE_LETTERS * text_px + 2 * unit, 0))
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


@lru_cache(4)
def text_panel(
    text: Overlay,
    bottom_px: int,
    window_px: Point,
    text_px: int,
    top_px: int = EDGE_PX,
    lit: Highlight = NO_HIGHLIGHT,
) -> Panel:
    """The title and lines of text with a cross, its items and its inset, between top_px and
    bottom_px: at the left, in the middle with a title, and at the bottom with items. Letters are
    smaller, and stand in more columns, if they do not fit.

    White on black is the same for both eyes, so text lies in the plane of the screen through any
    glasses. The inset is omitted if it does not fit.
    """
    sections = [part.split("\n") for part in "\n".join(text.lines).split("\n\n")]
    keys = [line.split("\t") for line in text.lines if "\t" in line]
    room = TEXT_SHARE * (window_px[0] - 2 * EDGE_PX), bottom_px - top_px - EDGE_PX
    sizes = product(range(text_px, SMALLEST_TEXT_PX - 1, -1), range(1, 4 if text.title else 2))
    for size_px, cols in sizes:
        unit = unit_px(size_px)
        pad, cross_px = 2 * unit, CONTROL_UNITS * unit
        title = written(text.title, round(HEADING * size_px), TEXT, True)
        top = pad + (title.get_height() + unit) * bool(text.title)
        widths = (  # of keys, and of the names of values, which have three parts
            badge(name, size_px, unit).get_width() if len(more) < 2 else font(size_px).size(name)[0]
            for name, *more in keys
        )
        key_px = max(widths, default=-2 * unit) + 2 * unit
        aside_px = 0 if text.title else cross_px - unit  # beside the first line
        wrap_px = int(room[0] - 2 * pad - aside_px - (cols - 1) * COLUMN_UNITS * unit) // cols
        wrap_px = max(wrap_px, key_px + COLUMN_LETTERS * size_px)
        blocks = [_block(part, size_px, key_px, wrap_px) for part in sections]
        areas = _columns(blocks, cols, unit)
        body = pygame.Rect.unionall(areas[0], areas[1:])
        rects = button_rects(text.items, size_px, round(room[0] - 2 * pad))
        row = pygame.Rect(0, 0, 0, -unit).unionall(rects)
        width = max(body.width + aside_px, title.get_width() + cross_px, row.width) + 2 * pad
        height = top + body.height + unit + row.height + pad
        if width <= room[0] and height <= room[1]:
            break
    blits = [(block, area.move(pad, top)) for block, area in zip(blocks, areas, strict=True)]
    cells = [
        (item, rect.move(pad, height - pad - row.height))
        for item, rect in zip(text.items, rects, strict=True)
    ]
    if text.inset is not None and height + text.inset.shape[0] + pad <= room[1]:
        inset = pygame.image.frombuffer(text.inset.tobytes(), text.inset.shape[1::-1], "BGR")
        blits.append((inset, inset.get_rect(topleft=(pad, height))))
        width = max(width, inset.get_width() + 2 * pad)
        height = height + inset.get_height() + pad
    surface = panel_surface(width, height, unit)
    surface.blits([(title, title.get_rect(topleft=(pad, pad))), *blits])
    cells.append(_cross(width, unit))
    for item, rect in cells:
        draw_button(surface, size_px, item, rect, lit, unit)
    x = (window_px[0] - width) // 2 if text.title or text.items else EDGE_PX
    middle = top_px + max(0, room[1] - height) // 2 if text.title else top_px
    at = round(x), round(bottom_px - height - EDGE_PX if text.items else middle)
    return Panel(surface=surface, at=at, cells=cells)


@lru_cache(8)
def notice_panel(
    notice: Notice,
    y_px: int,
    below: bool,
    window_px: Point,
    text_px: int,
    lit: Highlight = NO_HIGHLIGHT,
) -> Panel:
    """A notice above or below y_px; its items are beside the text or below it."""
    unit = unit_px(text_px)
    pad = 2 * unit
    room = window_px[0] - 2 * EDGE_PX - 2 * pad
    text = written(notice.text, text_px, TEXT, wrap_px=room)
    rects = button_rects(notice.items, text_px, room)
    row = pygame.Rect(0, 0, -2 * unit, 0).unionall(rects)
    beside = text.get_width() + 2 * unit + row.width <= room
    width, height = text.get_width() + 2 * pad, text.get_height() + pad
    at = 0, text.get_height() + 2 * unit
    if rects and beside:
        width, height = width + 2 * unit + row.width, max(height, row.height + pad)
        at = text.get_width() + 2 * unit, (height - row.height) // 2 - unit
    elif rects:
        width, height = max(width, row.width + 2 * pad), height + row.height + 2 * unit
    surface = panel_surface(width, height, unit)
    middle = height // 2 if beside or not rects else unit + text.get_height() // 2
    surface.blit(text, text.get_rect(midleft=(pad, middle)))
    cells = [
        (item, rect.move(pad + at[0], unit + at[1]))
        for item, rect in zip(notice.items, rects, strict=True)
    ]
    for item, rect in cells:
        draw_button(surface, text_px, item, rect, lit, unit)
    at = (window_px[0] - width) // 2, y_px if below else y_px - height
    return Panel(surface=surface, at=at, cells=cells)


def _stacked(parts: Sequence[pygame.Surface], unit: int, aside_px: int = 0) -> pygame.Surface:
    """A panel of parts below each other, beside a free space."""
    height = sum(part.get_height() for part in parts) + 2 * unit
    width = max(part.get_width() for part in parts) + 4 * unit + aside_px
    surface = panel_surface(width, height, unit)
    y = unit
    for part in parts:
        surface.blit(part, (2 * unit + aside_px, y))
        y += part.get_height()
    return surface


@lru_cache(2)
def caption_panels(
    overlay: Overlay, bottom_px: int, window_px: Point, text_px: int, lit: Highlight
) -> list[Panel]:
    """What visitors see of an exhibition: a title and lines at the bottom left and buttons at the
    right, all large, and the time that has passed.
    """
    unit, large_px = unit_px(text_px), round(CAPTION * text_px)
    title, *lines = filter(None, overlay.caption)
    wrap_px = round(0.6 * window_px[0])
    heading = written(title, round(HEADING * large_px), TEXT, True, wrap_px)
    texts = [written(line, large_px, SECOND, wrap_px=wrap_px) for line in lines]
    about = _stacked([heading, *texts], unit_px(large_px))
    panels = [Panel(surface=about, at=(EDGE_PX, bottom_px - about.get_height()))]
    if overlay.items:
        turns = notice_panel(Notice("", overlay.items), 0, True, window_px, large_px, lit)
        width, height = turns.surface.get_size()
        at = window_px[0] - EDGE_PX - width, bottom_px - height
        panels.append(attrs.evolve(turns, at=at))
    if overlay.elapsed is not None:
        time_bar = pygame.Surface((window_px[0], unit // 2))
        time_bar.fill(CARD)
        time_bar.fill(ACCENT, (0, 0, round(overlay.elapsed * window_px[0]), unit // 2))
        panels.append(Panel(surface=time_bar, at=(0, window_px[1] - unit // 2)))
    return panels


@lru_cache(2)
def scene_panel(name: str, step: str, share: float | None, window_px: Point, text_px: int) -> Panel:
    """The scene's name at the top left, and what is being done with it."""
    unit = unit_px(text_px)
    name = shortened(drawable(name), text_px, window_px[0] // 2)
    parts = [written(name, text_px, TEXT, True)]
    if step:
        groove = pygame.Rect(0, unit // 2, CHIP_LETTERS * text_px, unit // 2)
        bar = pygame.Surface((groove.width, 3 * unit // 2), pygame.SRCALPHA)
        pygame.draw.rect(bar, OFF, groove, border_radius=unit // 4)
        groove.width = round((share or 0.0) * groove.width)
        pygame.draw.rect(bar, ACCENT, groove, border_radius=unit // 4)
        parts += [written(step, text_px, SECOND), bar]
    return Panel(surface=_stacked(parts, unit), at=(EDGE_PX, EDGE_PX))


@lru_cache(4)
def dot_panel(
    text: str, colour: tuple[int, int, int], top_px: int, window_px: Point, text_px: int
) -> Panel:
    """A dot and text at the top right."""
    unit = unit_px(text_px)
    surface = _stacked([written(text, text_px, TEXT)], unit, 2 * unit)
    place, radius = (5 * unit // 2, surface.get_height() // 2), unit // 2 + 1
    pygame.draw.aacircle(surface, colour, place, radius)
    pygame.draw.circle(surface, colour, place, radius - 1)
    return Panel(surface=surface, at=(window_px[0] - surface.get_width() - EDGE_PX, top_px))


def top_px(text_px: int) -> int:
    """Where panels begin below the chips in the upper corners."""
    return EDGE_PX + font(text_px).get_linesize() + 2 * unit_px(text_px) + GAP_PX
