"""Drawing of the overlay: each function returns one panel, a surface with the places of its items. Equal
calls of one after another return the same panel."""

from functools import lru_cache

import attrs
import cv2

from lfpipe.files.decoding import fit_area
from lfpipe.render.overlay import Item, Menu, Overlay
from lfpipe.render.window_system import drawable, pygame

Place = tuple[int, int]
WHITE, GREY, RED, BACK, LIT = (255, 255, 255), (170, 170, 170), (255, 90, 90), (0, 0, 0, 200), (90, 90, 90, 220)
EDGE_PX, PROGRESS_PX = 12, 4
LEAST_TEXT_PX = 12  # still legible
TEXT_SHARE = 0.94  # of the window that lines of text may take
COLUMN = "PgDn PgUpM"  # as wide as the keys of the help
BAR_SHARE, BAR_LETTERS = 0.3, 36  # of the height, at most; width of a window with room for the usual size, in text heights
SLIDER_LINES = 14  # width of a slider
MENU_SHARE, MENU_COLS, CELL_LINES = 0.9, 5, 6  # of the window, at most; cells across, at most; their least size in lines
CELL_SHAPE = 0.75  # of a cell's picture, at most: height over width


@attrs.define(eq=False)
class Panel:
    """A drawn surface. cells: the items with their places on it. at: its place in the window. cols, page: of a menu."""

    surface: pygame.Surface
    at: Place
    cells: list[tuple[Item, pygame.Rect]] = attrs.field(factory=list)
    cols: int = 1
    page: int = 1

    @property
    def bottom(self) -> int:
        return self.at[1] + self.surface.get_height()

    def cell(self, place: Place) -> tuple[Item, pygame.Rect] | None:
        """The item at a place of the window, and its rectangle in the window."""
        inside = place[0] - self.at[0], place[1] - self.at[1]
        return next(((item, rect.move(self.at)) for item, rect in self.cells if rect.collidepoint(inside)), None)


def slider_event(item: Item, rect: pygame.Rect, x: int) -> str:
    """The event of a slider's item when it is held at x. rect: of the item."""
    groove = _groove(rect)
    return f"{item.event} {min(max((x - groove.left) / groove.width, 0.0), 1.0):.2f}"


def _groove(rect: pygame.Rect) -> pygame.Rect:
    return rect.inflate(-0.56 * rect.width, 0)  # a word on either side


def _fitted(font: pygame.font.Font, text: str, width_px: int, colour: tuple[int, int, int]) -> pygame.Surface:
    """text, cut where it does not fit."""
    text = drawable(text)
    while len(text) > 1 and font.size(text)[0] > width_px:
        text = text[:-2].rstrip() + "…"
    return font.render(text, True, colour)


def _draw_item(surface: pygame.Surface, font: pygame.font.Font, item: Item, rect: pygame.Rect, marked: bool) -> None:
    """Draws a picture, the label below it, and below that the key or the slider."""
    line, below = font.get_linesize(), bool(item.key) or item.slider is not None
    if marked:
        surface.fill(LIT, rect)
        pygame.draw.rect(surface, WHITE, rect, max(1, line // 10), border_radius=line // 4)
    room = rect.inflate(-line // 2, -line // 2)
    label = _fitted(font, item.label, room.width, RED if item.warns else WHITE)
    top = room.bottom - (1 + below) * line
    surface.blit(label, label.get_rect(midtop=(room.centerx, top)))
    if item.slider is not None:
        groove = _groove(rect)
        y = top + line + line // 2
        for word, corner, x in (("comfort", "midright", groove.left - line // 2), ("true", "midleft", groove.right + line // 2)):
            words = font.render(word, True, GREY)
            surface.blit(words, words.get_rect(**{corner: (x, y)}))
        pygame.draw.line(surface, GREY, (groove.left, y), (groove.right, y), 4)
        pygame.draw.circle(surface, WHITE, (groove.left + round(item.slider * groove.width), y), max(5, line // 3))
    elif item.key:
        key = font.render(item.key, True, GREY)
        surface.blit(key, key.get_rect(midtop=(room.centerx, top + line)))
    if item.picture is not None:
        rows, cols, channels = item.picture.shape
        x, y, *size = fit_area((cols, rows), (room.width, max(1, top - room.top - line // 4)))
        small = cv2.resize(item.picture, size, interpolation=cv2.INTER_AREA).tobytes()
        surface.blit(pygame.image.frombuffer(small, size, "RGB" if channels == 3 else "RGBA"), (room.left + x, room.top + y))


@lru_cache(1)
def bar_panel(items: tuple[Item, ...], marked: str, window_px: Place, text_px: int) -> Panel:
    """The items in rows at the bottom edge, never over the middle. marked: the event whose item is lit."""
    width, height = window_px
    for size_px in range(max(LEAST_TEXT_PX, min(text_px, width // BAR_LETTERS)), LEAST_TEXT_PX - 1, -1):
        font = pygame.font.Font(None, size_px)
        line, rows = font.get_linesize(), [list[tuple[Item, int]]()]
        for item in items:
            wide = SLIDER_LINES * line if item.slider is not None else font.size(item.label)[0] + line
            if rows[-1] and sum(w for _, w in rows[-1]) + wide > width:
                rows.append([])
            rows[-1].append((item, wide))
        row_px = 2 * line + line // 2
        if len(rows) * row_px <= BAR_SHARE * height:
            break
    panel = Panel(pygame.Surface((width, len(rows) * row_px), pygame.SRCALPHA), (0, height - len(rows) * row_px))
    panel.surface.fill(BACK)
    for number, row in enumerate(rows):
        x, spare_px = 0, (width - sum(wide for _, wide in row)) // len(row)  # spread over the width
        for item, wide in row:
            rect = pygame.Rect(x, number * row_px, wide + spare_px, row_px)
            x = rect.right
            panel.cells.append((item, rect))
            _draw_item(panel.surface, font, item, rect, item.event == marked)
    return panel


@lru_cache(2)
def menu_panel(menu: Menu, selected: int, window_px: Place, text_px: int) -> Panel:
    """The page with the selected item, in the middle of the window."""
    width, height = (round(MENU_SHARE * side) for side in window_px)
    font = pygame.font.Font(None, max(LEAST_TEXT_PX, min(round(1.2 * text_px), width // 26)))
    line = font.get_linesize()
    count = len(menu.items)
    hint = font.render(menu.hint, True, GREY, None, width - line)
    head_px = hint.get_height() + 3 * line

    def picture_px(cols: int) -> float:
        return min(width // cols, ((height - head_px) // -(-count // cols) - 2 * line) / CELL_SHAPE)

    cols = max(range(1, min(MENU_COLS, count) + 1), key=picture_px)
    if picture_px(cols) < CELL_LINES * line:  # then it has several pages
        cols = max(1, min(MENU_COLS, width // (CELL_LINES * line)))
    rows = max(1, min((height - head_px) // (CELL_LINES * line), -(-count // cols)))
    high = min((height - head_px) // rows, round(CELL_SHAPE * width / cols) + 2 * line)
    page, first = rows * cols, selected // (rows * cols) * rows * cols
    surface = pygame.Surface((width, head_px + rows * high), pygame.SRCALPHA)
    surface.fill(BACK)
    at = (window_px[0] - width) // 2, (window_px[1] - surface.get_height()) // 2
    panel = Panel(surface, at, cols=cols, page=page)
    title = font.render(menu.title + (f"   {selected + 1} of {count}" if page < count else ""), True, WHITE)
    surface.blit(title, title.get_rect(midtop=(width // 2, line // 2)))
    surface.blit(hint, hint.get_rect(midtop=(width // 2, 2 * line)))
    for place, item in enumerate(menu.items[first : first + page]):
        row, col = divmod(place, cols)
        rect = pygame.Rect(col * (width // cols), head_px + row * high, width // cols, high)
        panel.cells.append((item, rect))
        _draw_item(surface, font, item, rect, first + place == selected)
    return panel


@lru_cache(2)
def text_panel(text: Overlay, bottom_px: int | None, window_px: Place, text_px: int) -> Panel:
    """The lines and the inset at the top left, or in the middle above bottom_px; smaller letters if they do not fit.

    White on black is the same for both eyes, so text lies in the plane of the screen through any glasses. The inset is left out
    if there is no room.
    """
    columns, inset = [drawable(line).partition("\t") for line in text.lines], text.inset
    room = [TEXT_SHARE * (side - 2 * EDGE_PX) for side in window_px]
    for size_px in range(text_px, LEAST_TEXT_PX - 1, -1):
        font = pygame.font.Font(None, size_px)
        step, key_px = font.get_linesize(), font.size(COLUMN)[0]
        width = 16 + max(key_px + font.size(after)[0] if tab else font.size(before)[0] for before, tab, after in columns)
        height = 12 + step * len(columns)
        if width <= room[0] and height <= room[1]:
            break
    small = None
    if inset is not None and height + inset.shape[0] + 8 <= room[1]:
        small = pygame.image.frombuffer(inset.tobytes(), inset.shape[1::-1], "BGR")
        width, height = max(width, small.get_width() + 16), height + small.get_height() + 8
    surface = pygame.Surface((width, height), pygame.SRCALPHA)
    surface.fill((0, 0, 0, 160))
    for index, (before, _, after) in enumerate(columns):
        for x, words in ((8, before), (8 + key_px, after)):
            surface.blit(font.render(words, True, WHITE), (x, 6 + index * step))
    if small is not None:
        surface.blit(small, (8, height - small.get_height() - 8))
    at = (EDGE_PX, EDGE_PX) if bottom_px is None else ((window_px[0] - width) // 2, bottom_px - height - EDGE_PX)
    return Panel(surface, at)


@lru_cache(1)
def progress_panel(share: float, window_px: Place) -> Panel:
    """A thin line along the bottom."""
    line = pygame.Surface((max(1, round(share * window_px[0])), PROGRESS_PX))
    line.fill(WHITE)
    return Panel(line, (0, window_px[1] - PROGRESS_PX))
