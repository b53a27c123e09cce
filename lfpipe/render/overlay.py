"""Words over the picture: short notices, and the overlay of key o with rates, latency, depth and the grid of views."""

import numpy as np
from numpy.typing import NDArray

from lfpipe.render.geometry import zero_plane_px
from lfpipe.render.view_grid import EyesOnGrid, inset
from lfpipe.render.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import rate_hz

SHOWN_NS = 2 * SECOND_NS


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
        if text:
            self._states[subject] = text
        else:
            self._states.pop(subject, None)

    def lines(self, t_ns: int) -> list[str]:
        """The lines to show at t_ns."""
        self._passing = {subject: each for subject, each in self._passing.items() if each[1] > t_ns}
        texts = [*(text for text, _ in self._passing.values()), *self._states.values()]
        return [line for text in texts for line in text.splitlines()]


INSET_PX = 120


class StatusOverlay:
    """The current lines and the small picture below them."""

    def __init__(self, context: Context, viewer: Viewer) -> None:
        self._context, self._viewer = context, viewer

    def lines(self) -> list[str]:
        rows = self._context.table.rows
        own = rows[self._context.spec.name]
        age, horizon = (summary_ms(own[name]) for name in ("age", "horizon"))
        alpha = self._viewer.parallax
        busy = {name: (summary_ms(row["busy"])["p50_ms"], int(row["drops"])) for name, row in rows.items() if row["state"]}
        return [
            f"camera {rate_hz(rows[self._context.spec.source]):5.1f} Hz   pictures {rate_hz(own):5.1f} Hz",
            f"age of pictures p50 {age['p50_ms']:.1f} ms, p99 {age['p99_ms']:.1f} ms",
            f"eyes predicted by p50 {horizon['p50_ms']:.1f} ms",
            *([f"judder {judder:.2f} %"] if (judder := self._judder()) is not None else []),
            *(f"{name} busy p50 {p50_ms:.2f} ms, dropped {drops}" for name, (p50_ms, drops) in busy.items()),
            f"{self._viewer.method}, alpha {alpha.alpha_px:.1f} px/view" if alpha else f"{self._viewer.method}, no face yet",
            f"{self._context.config.render.anaglyph}{', frozen' if self._context.paused else ''}",
            self._depth(),
            *self._lowered(),
        ]

    def _judder(self) -> float | None:
        row = self._context.row
        return 100 * row["juddered"] / row["planned"] if row["planned"] else None

    def _lowered(self) -> list[str]:
        """What the governor has reduced."""
        level = self._context.options.level
        return [f"quality lowered, level {level.number}: {level.words}"] if level else []

    def map(self) -> NDArray[np.uint8] | None:
        """The grid of views with the eyes in it; the left eye's dot is filled."""
        shown, field = self._viewer.shown, self._viewer.field
        if shown is None:
            return None
        lx, ly, rx, ry = shown.eyes_px
        eyes, views = ((lx, ly), (rx, ry)), (shown.left, shown.right)
        return inset(EyesOnGrid(field.rows, field.cols, 0.0, (0.0, 0.0), eyes, views, True), INSET_PX)

    def _depth(self) -> str:
        """The zero plane as a slider between the farthest and the nearest of the scene."""
        field = self._viewer.field
        zero = zero_plane_px(field, self._context.config.render)
        low, high = field.disparity_min_px, field.disparity_max_px
        at = min(max(round(20 * (zero - low) / (high - low)), 0), 20) if high > low else 10
        return f"depth [{'-' * at}|{'-' * (20 - at)}] zero plane {zero:+.2f} px/view"
