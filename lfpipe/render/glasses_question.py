"""The question of the first start: which glasses do you have? Its answer is kept in the person's settings."""

import attrs

from lfpipe.render.window_system import pygame

TEXT_SHARE, LEAST_TEXT_PX = 1 / 20, 16  # of the height
WHITE, GREY, BACK = (255, 255, 255), (170, 170, 170), (0, 0, 0, 225)
FRAME = (200, 200, 200)
STEPS = {"less": -1, "up": -1, "more": 1, "down": 1}
TITLE, HINT = "Which glasses do you have?", "Click, or use the arrows and Enter. Key e asks again."


@attrs.frozen
class Glasses:
    """words: for people. lenses: colours of the left and right one, None without. anaglyph: a value of `render.anaglyph`."""

    words: str
    lenses: tuple[tuple[int, int, int], tuple[int, int, int]] | None
    anaglyph: str


KINDS = (
    Glasses("red / cyan", ((220, 30, 30), (0, 190, 200)), "dubois"),
    Glasses("green / magenta", ((20, 170, 40), (210, 40, 200)), "dubois-green-magenta"),
    Glasses("amber / blue", ((240, 170, 0), (30, 40, 190)), "dubois-amber-blue"),
    Glasses("3-D television", ((60, 60, 60), (60, 60, 60)), "side-by-side"),
    Glasses("none", None, "mono"),
)


class GlassesQuestion:
    """The menu of the kinds of glasses. at: the selected one."""

    def __init__(self, anaglyph: str) -> None:
        """anaglyph: the setting in force."""
        self.at = next((k for k, kind in enumerate(KINDS) if kind.anaglyph == anaglyph), 0)
        self._cells: list[pygame.Rect] = []

    def answer(self, event: str) -> Glasses | None:
        """The answer that an event of the window gives; None if it only moves the selection, or means nothing here."""
        if event in STEPS:
            self.at = (self.at + STEPS[event]) % len(KINDS)
        elif event == "enter":
            return KINDS[self.at]
        elif event.startswith("click "):
            x, y = map(int, event.split()[1:])
            return next((kind for kind, cell in zip(KINDS, self._cells, strict=True) if cell.collidepoint(x, y)), None)
        return None

    def understands(self, event: str) -> bool:
        """Whether an event is for the question."""
        return event in STEPS or event.startswith("click ")

    def draw(self, room_px: tuple[int, int]) -> pygame.Surface:
        """The question, for (width, height) px: one line of cells, or a list where it is narrow."""
        width, height = room_px
        line_px = max(LEAST_TEXT_PX, min(round(TEXT_SHARE * height), width // 32))
        font, big = pygame.font.Font(None, line_px), pygame.font.Font(None, round(1.5 * line_px))
        line = font.get_linesize()
        title, hint = big.render(TITLE, True, WHITE), font.render(HINT, True, GREY)
        top = 2 * line + title.get_height() + hint.get_height()
        wide = width // len(KINDS)
        high = min(height - top - line, max(wide, 5 * line))
        surface = pygame.Surface((width, top + high + line), pygame.SRCALPHA)
        surface.fill(BACK)
        surface.blit(title, title.get_rect(midtop=(width // 2, line)))
        surface.blit(hint, hint.get_rect(midtop=(width // 2, line + title.get_height() + line // 2)))
        self._cells = [pygame.Rect(k * wide, top, wide, high).inflate(-line // 2, 0) for k in range(len(KINDS))]
        for k, (kind, cell) in enumerate(zip(KINDS, self._cells, strict=True)):
            _draw_glasses(surface, kind, cell.move(0, -line))
            words = font.render(kind.words, True, WHITE)
            if words.get_width() > cell.width:
                words = pygame.transform.smoothscale_by(words, cell.width / words.get_width())
            surface.blit(words, words.get_rect(midbottom=(cell.centerx, cell.bottom - line // 2)))
            if k == self.at:
                pygame.draw.rect(surface, WHITE, cell, max(2, line // 8), border_radius=line // 3)
        return surface


def _draw_glasses(surface: pygame.Surface, kind: Glasses, cell: pygame.Rect) -> None:
    wide = round(0.42 * cell.width)
    high, gap = round(0.62 * wide), max(2, wide // 8)
    line = max(2, wide // 16)
    if kind.lenses is None:
        pygame.draw.circle(surface, FRAME, cell.center, high, line)
        offset = round(high * 0.7)
        x, y = cell.center
        pygame.draw.line(surface, FRAME, (x - offset, y + offset), (x + offset, y - offset), line)
        return
    for side, colour in zip((-1, 1), kind.lenses, strict=True):
        lens = pygame.Rect(0, 0, wide, high)
        lens.center = cell.centerx + side * (wide + gap) // 2, cell.centery
        pygame.draw.rect(surface, colour, lens, border_radius=high // 3)
        pygame.draw.rect(surface, FRAME, lens, line, border_radius=high // 3)
