"""Words over the picture: short notices, and the overlay of key o with rates, latency, depth and the grid of views."""

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Render
from lfpipe.render.geometry import zero_plane_px
from lfpipe.render.view_grid import EyesOnGrid, inset
from lfpipe.render.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import rate_hz

SHOWN_NS = 2 * SECOND_NS
MAP_PX, SLIDER_LETTERS = 120, 20


class Notices:
    """Lines by subject: a new line replaces the previous one of its subject."""

    def __init__(self) -> None:
        self._passing: dict[str, tuple[str, int]] = {}  # subject -> (text, end)
        self._states: dict[str, str] = {}

    def say(self, subject: str, text: str, t_ns: int, shown_ns: int = SHOWN_NS) -> None:
        """Shows text for shown_ns."""
        self._passing.pop(subject, None)  # the newest comes last
        self._passing[subject] = (text, t_ns + shown_ns)

    def state(self, subject: str, text: str) -> None:
        """Shows text until it is empty."""
        self._states[subject] = text

    def lines(self, t_ns: int) -> tuple[str, ...]:
        """The lines to show at t_ns."""
        self._passing = {subject: notice for subject, notice in self._passing.items() if notice[1] > t_ns}
        texts = [*(text for text, _ in self._passing.values()), *self._states.values()]
        return tuple(line for text in texts for line in text.splitlines())


def status_lines(context: Context, viewer: Viewer) -> tuple[str, ...]:
    """What the session does now, for the overlay."""
    rows = context.table.rows
    own = rows[context.spec.name]
    age, horizon = (summary_ms(own[name]) for name in ("age", "horizon"))
    alpha = f"alpha {viewer.parallax.alpha_px:.1f} px/view" if viewer.parallax else "no face yet"
    field, level = viewer.field, context.options.level
    zero_px, low_px, high_px = zero_plane_px(field, context.config.render), field.disparity_min_px, field.disparity_max_px
    share = min(max((zero_px - low_px) / (high_px - low_px), 0.0), 1.0) if high_px > low_px else 0.5
    at = round(SLIDER_LETTERS * share)
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
        f"{viewer.method}, {alpha}",
        f"{context.config.render.anaglyph}{', frozen' if context.paused else ''}",
        f"depth [{'-' * at}|{'-' * (SLIDER_LETTERS - at)}] zero plane {zero_px:+.2f} px/view",
        f"quality lowered, level {level.number}: {level.words}" if level else "",
    ]
    return tuple(line for line in lines if line)


def views_map(viewer: Viewer) -> NDArray[np.uint8] | None:
    """The grid of views with the eyes in it; the left eye's dot is filled."""
    eyes, field = viewer.shown, viewer.field
    if eyes is None:
        return None
    left_x, left_y, right_x, right_y = eyes.eyes_px
    places = ((left_x, left_y), (right_x, right_y))
    return inset(EyesOnGrid(field.rows, field.cols, 0.0, (0.0, 0.0), places, (eyes.left, eyes.right), True), MAP_PX)


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
