"""Boxes, texts and arrows of an SVG figure that a light and a dark page can show."""

from collections.abc import Sequence
from html import escape

import attrs

INK = "#1f2328"  # on a box
GREY = "#7d8590"  # on the page: readable on white and on black
CORE, EXTRA, MEMORY, OUTSIDE = "#cfe3ff", "#ffe2c2", "#d3f0dc", "#e6e8eb"  # fills of boxes
Point = tuple[float, float]


@attrs.frozen(kw_only=True)
class Box:
    """A rectangle with centred lines of text, the first one bold."""

    x: float
    """Its centre."""
    y: float
    """Its centre."""
    width: float
    height: float
    lines: Sequence[str]
    fill: str = CORE
    dashed: bool = False
    """Whether it exists only on demand."""
    slots: bool = False
    """Whether it is drawn as a ring: with a line between slots at either end."""

    @property
    def left(self) -> float:
        return self.x - self.width / 2

    @property
    def right(self) -> float:
        return self.x + self.width / 2

    @property
    def top(self) -> float:
        return self.y - self.height / 2

    @property
    def bottom(self) -> float:
        return self.y + self.height / 2

    def svg(self) -> str:
        dash = ' stroke-dasharray="5 3"' if self.dashed else ""
        corner = 2 if self.slots else min(6, self.height / 4)
        shape = (
            f'<rect x="{self.left:g}" y="{self.top:g}" width="{self.width:g}"'
            f' height="{self.height:g}" rx="{corner:g}" fill="{self.fill}"'
            f' stroke="{GREY}"{dash}/>'
        )
        parts = [shape]
        if self.slots:
            parts += [
                line([(x, self.top), (x, self.bottom)], arrow=False)
                for x in (self.left + 8, self.right - 8)
            ]
        first = self.y - 7.5 * (len(self.lines) - 1) + 4
        parts += [
            text((self.x, first + 15 * i), words, INK, bold=not i, small=bool(i))
            for i, words in enumerate(self.lines)
        ]
        return "\n".join(parts)


def text(
    at: Point,
    words: str,
    colour: str = GREY,
    *,
    bold: bool = False,
    small: bool = True,
    anchor: str = "middle",
) -> str:
    """A line of text. at: its anchor, on the base line."""
    weight = ' font-weight="bold"' if bold else ""
    return (
        f'<text x="{at[0]:g}" y="{at[1]:g}" fill="{colour}" font-size="{11 if small else 13}"'
        f' text-anchor="{anchor}"{weight}>{escape(words)}</text>'
    )


def line(
    points: Sequence[Point],
    *,
    colour: str = GREY,
    width: float = 1.2,
    arrow: bool = True,
    both: bool = False,
    dashed: bool = False,
) -> str:
    """A line through the points. arrow: at its end. both: at its beginning, too."""
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    more = ' marker-end="url(#end)"' if arrow else ""
    more += ' marker-start="url(#end)"' if both else ""
    more += ' stroke-dasharray="5 3"' if dashed else ""
    return (
        f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}"{more}/>'
    )


def figure(width: float, height: float, title: str, parts: Sequence[str]) -> str:
    """The text of the file."""
    return "\n".join(
        [
            (
                f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}"'
                f' width="{width:g}" height="{height:g}" font-family="sans-serif" role="img">'
            ),
            f"<title>{escape(title)}</title>",
            (
                '<defs><marker id="end" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="9"'
                f' markerHeight="9" markerUnits="userSpaceOnUse" orient="auto-start-reverse">'
                f'<path d="M0,0 L10,5 L0,10 z" fill="{GREY}"/></marker></defs>'
            ),
            *parts,
            "</svg>\n",
        ]
    )
