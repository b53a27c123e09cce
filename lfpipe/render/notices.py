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
        self._passing = {subject: notice for subject, notice in self._passing.items() if notice[1] > t_ns}
        texts = [*(text for text, _ in self._passing.values()), *self.standing]
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
        f"judder {100 * own['juddered'] / own['planned']:.2f} %" if own["planned"] else "",
        *(
            f"{name} busy p50 {summary_ms(row['busy'])['p50_ms']:.2f} ms, dropped {row['drops']}"
            for name, row in rows.items()
            if row["state"]
        ),
        f"{viewer.method}, {render.anaglyph}, {alpha}, zero plane {zero_plane_px(field, render):+.2f} px/view",
        f"row {views.left[0]:.1f}, columns {views.left[1]:.1f} and {views.right[1]:.1f} of {field.rows}x{field.cols} views"
        if views
        else "",
        f"quality lowered, level {level.number}: {level.words}" if level else "",
    ]
    return tuple(line for line in lines if line)


def changes(before: Render, now: Render) -> list[tuple[str, str]]:
    """(subject, text) of each changed setting that a viewer notices."""

    def number(value: float | str, form: str) -> str:
        return value if isinstance(value, str) else f"{value:{form}} px/view"

    texts = {
        "depth": ("depth", f"depth: {now.depth:.0%} of the way from comfort to true"),
        "anaglyph": ("mode", f"mode: {now.anaglyph}"),
        "zero_plane_px": ("depth", f"depth: zero plane {number(now.zero_plane_px, '+.2f')}"),
        "alpha_px": ("alpha", f"head movement: alpha {number(now.alpha_px, '.1f')}"),
        "method": ("method", f"views: {now.method}"),
        "swap_eyes": ("swap", "eyes swapped" if now.swap_eyes else "eyes as they are"),
        "ghost_compensation": ("ghost", f"ghost compensation: {now.ghost_compensation:.0f} %"),
    }
    return [text for name, text in texts.items() if getattr(now, name) != getattr(before, name)]
