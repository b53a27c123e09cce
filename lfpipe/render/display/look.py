"""How everything over the picture looks: colours, icons, keys as badges, and items in their states:
buttons, entries of the bar, rows and tiles of menus.

Sizes are in units of an eighth of a control's padding, so all grow with the letters. A surface's
pixels are replaced, not blended: a colour that lies on a panel is already mixed with it.
"""

import io
import math
from collections.abc import Iterable, Sequence
from functools import lru_cache

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.files.codecs import fit_area
from lfpipe.render.display import ACCENT, BACK, OFF, RED, SECOND, TEXT
from lfpipe.render.display.display import NO_EVENT, Event, Item
from lfpipe.render.display.window_system import drawable, font, pygame, written

Colour = tuple[int, int, int] | tuple[int, int, int, int]
Point = tuple[int, int]
DARK = (9, 22, 26)  # letters on ACCENT
AMBER = (255, 196, 84)
PANEL = (*BACK, 232)  # over white, second text still has 7 : 1
BORDER = (58, 62, 68, 240)  # visible on black
CARD = (31, 35, 41, 238)
HOVERED = (56, 61, 68, 242)
PRESSED = (24, 74, 84, 246)
UNIT_SHARE = 0.35  # of the letters' size: 8 px at 1080p
CONTROL_UNITS = 6  # height of a control: a finger hits it
ICON_PX = 24  # from here on, the lines of an icon get no wider


@attrs.frozen
class Highlight:
    """What the pointer is on."""

    event: Event = NO_EVENT
    pressed: bool = False


NO_HIGHLIGHT = Highlight()


def unit_px(text_px: int) -> int:
    """The unit of all spaces."""
    return max(4, round(UNIT_SHARE * text_px))


def panel_surface(width: float, height: float, unit: int) -> pygame.Surface:
    """An empty panel with its edge."""
    surface = pygame.Surface((round(width), round(height)), pygame.SRCALPHA)
    rect, corner = surface.get_rect(), 3 * unit // 2
    pygame.draw.rect(surface, PANEL, rect, border_radius=corner)
    pygame.draw.rect(surface, BORDER, rect, max(1, unit // 8), border_radius=corner)
    return surface


def draw_card(
    surface: pygame.Surface,
    rect: pygame.Rect,
    unit: int,
    item: Item,
    lit: Highlight,
    plain: Colour | None,
    focused: bool = False,
) -> bool:
    """The back of an item in its state; returns whether it is lit. plain: of one without any."""
    is_lit = item.event == lit.event and not item.off
    colour = (PRESSED if lit.pressed else HOVERED) if is_lit else plain
    if colour is not None:
        pygame.draw.rect(surface, colour, rect, border_radius=unit)
    if focused:
        pygame.draw.rect(surface, ACCENT, rect, max(2, unit // 4), border_radius=unit)
    return is_lit


def badge(key: str, text_px: int, unit: int) -> pygame.Surface:
    """A key, or several that are separated by spaces."""
    words = [written(name, text_px, TEXT) for name in key.split()]
    side = words[0].get_height() + unit // 2
    widths = [max(side, word.get_width() + unit) for word in words]
    surface = pygame.Surface((sum(widths) + unit // 2 * (len(words) - 1), side), pygame.SRCALPHA)
    x = 0
    for word, width in zip(words, widths, strict=True):
        rect = pygame.Rect(x, 0, width, side)
        pygame.draw.rect(surface, CARD, rect, border_radius=unit // 2)
        pygame.draw.rect(surface, SECOND, rect, max(1, unit // 8), border_radius=unit // 2)
        surface.blit(word, word.get_rect(center=rect.center))
        x += width + unit // 2
    return surface


SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="{0}" height="{0}" viewBox="0 0 24 24"'
    ' stroke="rgb{1}" fill="none" stroke-width="{3}" stroke-linecap="round"'
    ' stroke-linejoin="round">{2}</svg>'
)
_FOLDER = '<path d="M3 7a2 2 0 0 1 2-2h4l2 2h8a2 2 0 0 1 2 2v8a2 2 0 0 1-2 2H5a2 2 0 0 1-2-2z"/>'
_CAMERA = '<rect x="2" y="7" width="13" height="10" rx="2"/><path d="M15 11l6-3v8l-6-3"/>'
_FILM = '<rect x="3" y="5" width="18" height="14" rx="2"/><path d="M10 9l5 3-5 3z"/>'
ICONS = {  # event, or the kind of viewer -> drawing
    "camera": _CAMERA,
    "mouse": '<rect x="7" y="3" width="10" height="18" rx="5"/><path d="M12 7v4"/>',
    "demo": _FILM,
    "choose": '<rect x="3" y="3" width="8" height="8" rx="1"/>'
    '<rect x="13" y="3" width="8" height="8" rx="1"/>'
    '<rect x="3" y="13" width="8" height="8" rx="1"/>'
    '<rect x="13" y="13" width="8" height="8" rx="1"/>',
    "open": _FOLDER,
    "file": _FILM,
    "up": '<path d="M12 20V5M5 12l7-7 7 7"/>',
    "which": '<circle cx="6.5" cy="13" r="4"/><circle cx="17.5" cy="13" r="4"/>'
    '<path d="M10.5 13h3M2.5 13l1-5M21.5 13l-1-5"/>',
    "who": '<path d="M2 12s4-6 10-6 10 6 10 6-4 6-10 6S2 12 2 12z"/>'
    '<circle cx="12" cy="12" r="2.5"/>',
    "calibrate": '<path d="M4 8V4h4M16 4h4v4M20 16v4h-4M8 20H4v-4"/>'
    '<circle cx="12" cy="10" r="3"/><path d="M7 17a5 3.5 0 0 1 10 0"/>',
    "invert-depth": '<path d="M7 4v14M4 15l3 3 3-3M17 20V6M14 9l3-3 3 3"/>',
    "recentre": '<circle cx="12" cy="12" r="3"/><path d="M12 2v4M12 18v4M2 12h4M18 12h4"/>',
    "freeze": '<path d="M9 5v14M15 5v14"/>',
    "record": '<circle cx="12" cy="12" r="8"/><circle cx="12" cy="12" r="3"/>',
    "screenshot": '<rect x="3" y="6" width="18" height="13" rx="2"/>'
    '<circle cx="12" cy="12.5" r="3.5"/><path d="M8 6l1.5-2h5L16 6"/>',
    "fullscreen": '<path d="M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5"/>',
    "overlay": '<path d="M4 20V10M10 20V4M16 20v-8M22 20H2"/>',
    "help": '<circle cx="12" cy="12" r="9"/>'
    '<path d="M9.5 9.5a2.5 2.5 0 1 1 3.5 2.3c-.7.4-1 .9-1 1.7M12 17v.2"/>',
}


@lru_cache(64)
def icon(event: str, size_px: int, colour: Colour) -> pygame.Surface:
    """The icon of an event; its lines are equally wide at all sizes."""
    svg = SVG.format(size_px, colour[:3], ICONS[event], 2 * min(1, ICON_PX / size_px))
    return pygame.image.load(io.BytesIO(svg.encode()), "icon.svg")


def slider_groove(rect: pygame.Rect) -> pygame.Rect:
    """Where a slider moves in its item's rectangle."""
    return rect.inflate(-0.2 * rect.width, 0)


def draw_slider(surface: pygame.Surface, item: Item, rect: pygame.Rect, y: int, unit: int) -> None:
    groove = slider_groove(rect)
    at = groove.left + round((item.slider or 0.0) * groove.width)
    line = max(3, unit // 2)
    pygame.draw.line(surface, OFF, (groove.left, y), (groove.right, y), line)
    pygame.draw.line(surface, OFF if item.off else ACCENT, (groove.left, y), (at, y), line)
    pygame.draw.aacircle(surface, SECOND if item.off else TEXT, (at, y), max(6, unit))


def pages_of(
    sizes: Iterable[Point], room_px: tuple[int, float], gap: int
) -> list[list[pygame.Rect]]:
    """Rectangles of those sizes beside each other, in as many rows and pages as they need."""
    pages = list[list[pygame.Rect]]([[]])
    x = y = bottom = 0
    for width, height in sizes:
        if x and x + width > room_px[0]:
            x, y = 0, bottom + gap
        if pages[-1] and y + height > room_px[1]:
            pages.append([])
            x = y = 0
        pages[-1].append(pygame.Rect(x, y, width, height))
        x += width + gap
        bottom = y + height
    return pages


def draw_button(
    surface: pygame.Surface,
    text_px: int,
    item: Item,
    rect: pygame.Rect,
    lit: Highlight,
    unit: int,
) -> None:
    """A label with its key, or above its slider; without a back if it is a single letter."""
    back = ACCENT if item.main and not item.off else CARD
    is_lit = draw_card(surface, rect, unit, item, lit, back if len(item.label) > 1 else None)
    colour = DARK if back == ACCENT and not is_lit else TEXT
    label = written(item.label, text_px, OFF if item.off else colour, item.main)
    if item.slider is not None:
        surface.blit(label, label.get_rect(midtop=(rect.centerx, rect.top + unit // 2)))
        draw_slider(surface, item, rect, rect.bottom - 3 * unit // 2, unit)
        return
    parts = [label, *([badge(item.key, text_px, unit)] if item.key else [])]
    x = rect.centerx - (sum(part.get_width() + unit for part in parts) - unit) // 2
    for part in parts:
        surface.blit(part, part.get_rect(midleft=(x, rect.centery)))
        x += part.get_width() + unit


def button_rects(items: Sequence[Item], text_px: int, room_px: int) -> list[pygame.Rect]:
    """The places of buttons, in as many rows as they need."""
    unit = unit_px(text_px)
    sizes = list[Point]()
    for item in items:
        key = badge(item.key, text_px, unit).get_width() + unit if item.key else 0
        wide = font(text_px, item.main).size(item.label)[0] + key + 4 * unit
        sizes.append((max(wide, 18 * unit * (item.slider is not None)), CONTROL_UNITS * unit))
    return pages_of(sizes, (room_px, math.inf), unit)[0]


def draw_entry(
    surface: pygame.Surface,
    text_px: int,
    item: Item,
    rect: pygame.Rect,
    lit: Highlight,
    worded: bool,
    beside: bool,
    unit: int,
) -> None:
    """An entry of the bar: an icon or a slider, and its label."""
    draw_card(surface, rect, unit, item, lit, None)
    colour = OFF if item.off else RED if item.warns else TEXT
    label = written(item.label * worded, text_px, colour)
    is_over = worded and not beside
    middle = rect.top + 2 * unit if is_over else rect.centery
    if item.slider is not None:
        draw_slider(surface, item, rect, middle, unit)
    else:
        drawing = icon(item.event.name, 11 * unit // 4, colour)
        left = rect.left + unit if beside else rect.centerx - drawing.get_width() // 2
        surface.blit(drawing, drawing.get_rect(midleft=(left, middle)))
    if is_over:
        surface.blit(label, label.get_rect(midbottom=(rect.centerx, rect.bottom - unit // 2)))
    elif item.slider is not None:
        surface.blit(label, label.get_rect(midright=(rect.left + unit, rect.centery)))
    else:
        surface.blit(label, label.get_rect(midleft=(rect.left + 9 * unit // 2, rect.centery)))


def draw_row(
    surface: pygame.Surface,
    text_px: int,
    item: Item,
    rect: pygame.Rect,
    lit: Highlight,
    focused: bool,
    unit: int,
) -> None:
    """An icon or a picture, the label, and what else there is to say; or a heading."""
    if not item.event.name:
        heading = written(item.label, text_px, TEXT, True)
        surface.blit(heading, heading.get_rect(midleft=(rect.left, rect.centery)))
        return
    draw_card(surface, rect, unit, item, lit, PRESSED if item.main else CARD, focused)
    x = rect.left + 2 * unit
    if item.icon:
        drawing = icon(item.icon, 3 * unit, TEXT)
        surface.blit(drawing, drawing.get_rect(midleft=(x, rect.centery)))
        x += 5 * unit
    if item.picture is not None:
        frame = pygame.Rect(x, rect.top + unit, 10 * unit, rect.height - 2 * unit)
        _draw_picture(surface, item.picture, frame)
        x += 12 * unit
    for text, colour, bold in ((item.label, TEXT, True), (item.more, SECOND, False)):
        words = written(shortened(text, text_px, rect.right - x - unit), text_px, colour, bold)
        surface.blit(words, words.get_rect(midleft=(x, rect.centery)))
        x += words.get_width() + 2 * unit


def shortened(text: str, text_px: int, room_px: int) -> str:
    """Of a longer text, both ends, because names of files often differ at the end."""
    short = text
    for count in range(len(text) - 1, 1, -1):
        if font(text_px, True).size(short)[0] <= room_px:
            break
        short = f"{text[: count - count // 2]}…{text[-(count // 2) :]}"
    return short


def _draw_picture(surface: pygame.Surface, picture: NDArray[np.uint8], space: pygame.Rect) -> None:
    """A picture, scaled to fit."""
    rows, cols, channels = picture.shape
    x, y, *size = fit_area((cols, rows), space.size)
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).tobytes()
    surface.blit(
        pygame.image.frombuffer(small, size, "RGB" if channels == 3 else "RGBA"),
        (space.left + x, space.top + y),
    )


def draw_tile(
    surface: pygame.Surface,
    text_px: int,
    item: Item,
    rect: pygame.Rect,
    lit: Highlight,
    focused: bool,
    unit: int,
) -> None:
    """A card with a picture or an icon, and the label and a second line below it."""
    draw_card(surface, rect, unit, item, lit, CARD, focused)
    room = rect.inflate(-2 * unit, -2 * unit)
    y = room.bottom
    for text, ink, bold in (
        (item.more, RED if item.warns else SECOND, False),
        (item.label, TEXT, True),
    ):
        words = written(shortened(drawable(text), text_px, room.width), text_px, ink, bold)
        surface.blit(words, words.get_rect(bottomleft=(room.left, y)))
        y -= words.get_height()
    room.height = max(1, y - room.top - unit)
    if item.picture is not None:
        _draw_picture(surface, item.picture, room)
    elif item.icon:
        drawing = icon(item.icon, 5 * unit, SECOND)
        surface.blit(drawing, drawing.get_rect(center=room.center))
