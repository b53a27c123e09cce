"""Words over the picture: short notices, and the overlay of key o with rates, latency, depth and the views on show."""

from lfpipe.config import Render
from lfpipe.render.geometry import zero_plane_px
from lfpipe.render.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import rate_hz

SHOWN_NS = 2 * SECOND_NS


class Notices:
    """Lines that pass, by subject: a new one replaces the previous one of its subject. standing: those that stay."""

    def __init__(self) -> None:
        self.standing: list[str] = []
        self._passing: dict[str, tuple[str, int]] = {}  # subject -> (text, end)

    def say(self, subject: str, text: str, shown_ns: int = SHOWN_NS) -> None:
        """Shows text for shown_ns."""
        self._passing.pop(subject, None)  # the newest comes last
        self._passing[subject] = text, now_ns() + shown_ns

    def lines(self, t_ns: int) -> tuple[str, ...]:
        """The lines to show at t_ns."""
        texts = [*(text for text, end_ns in self._passing.values() if end_ns > t_ns), *self.standing]
        return tuple(line for text in texts for line in text.splitlines())


def status_lines(context: Context, viewer: Viewer) -> tuple[str, ...]:
    """What the session does now, for the overlay."""
    rows = context.table.rows
    own = rows[context.spec.name]
    age, horizon = (summary_ms(own[name]) for name in ("age", "horizon"))
    field, level, render, views = viewer.field, context.options.level, context.config.render, viewer.shown
    alpha = f"alpha {viewer.parallax.alpha_px:.1f} px/view" if viewer.parallax else "no face yet"
    lines = [
        f"camera {rate_hz(rows[context.spec.source]):5.1f} Hz   pictures {rate_hz(own):5.1f} Hz",
        f"age of pictures p50 {age['p50_ms']:.1f} ms, p99 {age['p99_ms']:.1f} ms",
        f"eyes predicted by p50 {horizon['p50_ms']:.1f} ms",
    ]
    if own["planned"]:
        lines.append(f"judder {100 * own['juddered'] / own['planned']:.2f} %")
    for name, row in rows.items():
        if row["state"]:
            lines.append(f"{name} busy p50 {summary_ms(row['busy'])['p50_ms']:.2f} ms, dropped {row['drops']}")
    lines.append(f"{viewer.method}, {render.anaglyph}, {alpha}, zero plane {zero_plane_px(field, render):+.2f} px/view")
    if views:
        columns = f"columns {views.left[1]:.1f} and {views.right[1]:.1f}"
        lines.append(f"row {views.left[0]:.1f}, {columns} of {field.rows}x{field.cols} views")
    if level:
        lines.append(f"quality lowered, level {level.number}: {level.words}")
    return tuple(lines)


def changes(before: Render, now: Render) -> dict[str, str]:
    """A notice for each changed setting that a viewer notices, by its subject."""

    def px(value: float | str, form: str) -> str:
        return value if isinstance(value, str) else f"{value:{form}} px/view"

    texts = {
        "depth": f"depth: {now.depth:.0%} of the way from comfort to true",
        "anaglyph": f"mode: {now.anaglyph}",
        "zero_plane_px": f"depth: zero plane {px(now.zero_plane_px, '+.2f')}",
        "alpha_px": f"head movement: alpha {px(now.alpha_px, '.1f')}",
        "method": f"views: {now.method}",
        "swap_eyes": "eyes swapped" if now.swap_eyes else "eyes as they are",
        "ghost_compensation": f"ghost compensation: {now.ghost_compensation:.0f} %",
    }
    return {name: text for name, text in texts.items() if getattr(now, name) != getattr(before, name)}
