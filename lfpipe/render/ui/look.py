"""How everything over the picture looks: colours, panels, states, icons, and keys as badges.

Sizes are in units of an eighth of a control's padding, so all grow with the letters. A surface's
pixels are replaced, not blended: a colour that lies on a panel is already mixed with it.
"""

import io
from functools import lru_cache

import attrs

from lfpipe.render.display.display import ACCENT, BACK, NO_EVENT, SECOND, TEXT, Event, Item
from lfpipe.render.display.window_system import pygame, written

Colour = tuple[int, int, int] | tuple[int, int, int, int]
Place = tuple[int, int]
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
