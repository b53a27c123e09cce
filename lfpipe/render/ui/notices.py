"""Words over the picture: short notices, and the overlay of key o with rates, latency, depth and
the views on show.
"""

from lfpipe.config import Render
from lfpipe.notices import latency_lines
from lfpipe.render.viewer.geometry import zero_plane_px
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import State, rate_hz

SHOWN_NS = 2 * SECOND_NS  # a line is read in one
GLASSES = {  # a value of render.anaglyph -> whom its colours are for
    "dubois": "red/cyan glasses",
    "colour": "red/cyan glasses, full colours",
    "half-colour": "red/cyan glasses, half the colours",
    "grey": "red/cyan glasses, grey",
    "wimmer": "red/cyan glasses, muted reds",
    "dubois-green-magenta": "green/magenta glasses",
    "dubois-amber-blue": "amber/blue glasses",
    "mono": "no glasses",
    "side-by-side": "a 3-D television, side by side",
    "row-interleaved": "a 3-D screen, row by row",
}


class Notices:
    """Lines that pass, by subject: a new one replaces the previous one of its subject."""

    def __init__(self) -> None:
        self._passing: dict[str, tuple[str, int]] = {}  # subject -> (text, end)

    def say(self, subject: str, text: str, shown_ns: int = SHOWN_NS) -> None:
        """Shows text for shown_ns."""
        self._passing.pop(subject, None)  # the newest comes last
        self._passing[subject] = text, now_ns() + shown_ns

    def lines(self, t_ns: int, standing: list[str]) -> tuple[str, ...]:
        """The lines to show at t_ns. standing: those that stay as long as they are true."""
        passing = [text for text, end_ns in self._passing.values() if end_ns > t_ns]
        return tuple(filter(None, (*passing, *standing)))


def status_lines(context: Context, viewer: Viewer) -> tuple[str, ...]:
    """What the session does now, for the overlay; `lfpipe monitor` has more."""
    own, source = (context.table.rows[name] for name in (context.spec.name, context.spec.source))
    field = viewer.field
    render = context.config.render
    views = viewer.last_viewpoints
    alpha = f"alpha {viewer.parallax.alpha_px:.1f} px/view" if viewer.parallax else "no face yet"
    has_camera = source["state"] != State.NONE
    camera = f"camera {rate_hz(source):5.1f} Hz" if has_camera else "no camera"
    lines = [
        f"{camera}   pictures {rate_hz(own):5.1f} Hz",
        *latency_lines(
            summary_ms(own["age"]),
            summary_ms(context.row.histograms["prediction"].record),
            bool(context.row["planned"]),
        ),
        (
            f"{viewer.method}, {render.anaglyph}, {alpha}, zero plane"
            f" {zero_plane_px(field, render):+.2f} px/view"
        ),
    ]
    if views:
        lines.append(
            f"row {views.left[0]:.1f}, columns {views.left[1]:.1f} and {views.right[1]:.1f} of"
            f" {field.rows}x{field.cols} views"
        )
    return tuple(lines)


def changes(before: Render, now: Render, alpha_px: float, plane_px: float) -> dict[str, str]:
    """A notice for each changed setting that a viewer notices, by its key. The overlay has the
    numbers.

    alpha_px, plane_px: what was in force before, for a setting that was "auto".
    """
    words = {
        "depth": f"depth: {now.depth:.0%} of the way from comfort to true",
        "anaglyph": f"colours for: {GLASSES[now.anaglyph]}",
        "zero_plane_px": "depth: "
        + _way(now.zero_plane_px, plane_px, "the scene goes back", "the scene comes forward"),
        "alpha_px": f"head movement: {_way(now.alpha_px, alpha_px, 'more', 'less')}",
        "method": f"views: {now.method}",
        "swap_eyes": f"eyes: {'swapped' if now.swap_eyes else 'as they are'}",
        "ghost_compensation": f"ghost compensation: {now.ghost_compensation:.0f} %",
    }
    return {
        name: text for name, text in words.items() if getattr(before, name) != getattr(now, name)
    }


def _way(value: float | str, before: float, up: str, down: str) -> str:
    if isinstance(value, str):
        return "automatic"
    return up if value > before else down
