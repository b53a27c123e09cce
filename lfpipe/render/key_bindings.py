"""What the viewer's keys do: settings go through the supervisor, like everybody's, so that all know of them."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import choices
from lfpipe.render.display import Display
from lfpipe.render.picture_file import save
from lfpipe.render.presenter import Presenter
from lfpipe.render.view_grid import EyesOnGrid, inset
from lfpipe.render.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import State, rate_hz

ALPHA_STEP = 1.1
DEPTH_STEP_PX = 0.1
INSET_PX = 120
MODES = choices("render.anaglyph")
SETTLED_NS = SECOND_NS // 2  # a resize is over once the width stayed the same this long
OVERLAY_NS = SECOND_NS // 2
LOST = "camera lost, trying again"


class KeyBindings:
    """Serves a display's events and its overlay."""

    def __init__(self, context: Context, viewer: Viewer, presenter: Presenter, display: Display) -> None:
        self._context, self._viewer, self._presenter, self._display = context, viewer, presenter, display
        self._overlay_due_ns = 0
        self._width_mm, self._settled_ns = display.width_mm(), 0
        self._overlay = self._lost = False

    def serve(self) -> None:
        """Carries out what was pressed since the last call, and keeps the overlay fresh."""
        for event in self._display.events():
            self._presenter.redraw()
            if event == "quit":
                self._context.request("stop")
            elif event == "recentre":
                self._context.request("recentre")
            elif event == "screenshot":
                self._screenshot()
            elif event == "overlay":
                self._overlay, self._overlay_due_ns = not self._overlay, 0
                self._display.overlay([LOST] if self._lost else [])
            elif event == "freeze":
                self._context.request("resume" if self._context.paused else "pause")
            elif event == "mode":
                mode = MODES[(MODES.index(self._context.config.render.anaglyph) + 1) % len(MODES)]
                self._context.request("set", set={"render.anaglyph": mode})
            elif event in ("depth+", "depth-"):
                moved_px = self._context.config.render.zero_plane_px + (DEPTH_STEP_PX if event == "depth+" else -DEPTH_STEP_PX)
                self._context.request("set", set={"render.zero_plane_px": round(moved_px, 3)})
            elif event in ("alpha+", "alpha-") and self._viewer.parallax is not None:
                step = ALPHA_STEP if event == "alpha+" else 1 / ALPHA_STEP
                self._context.request("set", set={"render.alpha_px": round(self._viewer.parallax.alpha_px * step, 3)})
        self.pass_on_notices()
        self._follow_width()
        lost = bool(self._context.table.rows["capture"]["state"] == State.READY)  # it has no camera to take frames of
        if lost != self._lost:
            self._lost, self._overlay_due_ns = lost, 0
            self._display.overlay([LOST] if lost else [])
        if self._overlay and now_ns() >= self._overlay_due_ns:
            self._overlay_due_ns = now_ns() + OVERLAY_NS
            self._display.overlay([*([LOST] if lost else []), *self._lines()], self._map())
            self._presenter.redraw()

    def _follow_width(self) -> None:
        """A picture shown larger asks for more of the eyes: alpha follows once the window has its size."""
        width_mm = self._display.width_mm()
        if width_mm != self._width_mm:
            self._width_mm, self._settled_ns = width_mm, now_ns() + SETTLED_NS
        elif now_ns() >= self._settled_ns and self._viewer.shown_as_wide(width_mm):
            self._presenter.redraw()

    def pass_on_notices(self) -> None:
        """Emits the display's notices."""
        for notice in self._display.notices():
            self._context.emit("notice", text=notice)

    def _lines(self) -> list[str]:
        rows = self._context.table.rows
        age, horizon = (summary_ms(rows["render"][name]) for name in ("age", "horizon"))
        alpha = self._viewer.parallax
        busy = {name: (summary_ms(row["busy"])["p50_ms"], int(row["drops"])) for name, row in rows.items() if row["state"]}
        return [
            f"camera {rate_hz(rows['capture']):5.1f} Hz   pictures {rate_hz(rows['render']):5.1f} Hz",
            f"sensor to screen p50 {age['p50_ms']:.1f} ms, p99 {age['p99_ms']:.1f} ms",
            f"eyes predicted by p50 {horizon['p50_ms']:.1f} ms",
            *([f"judder {judder:.2f} %"] if (judder := self._judder()) is not None else []),
            *(f"{name} busy p50 {p50_ms:.2f} ms, dropped {drops}" for name, (p50_ms, drops) in busy.items()),
            f"{self._viewer.method}, alpha {alpha.alpha_px:.1f} px/view" if alpha else f"{self._viewer.method}, no face seen yet",
            f"{self._context.config.render.anaglyph}{', frozen' if self._context.paused else ''}",
            self._depth(),
            *self._lowered(),
        ]

    def _judder(self) -> float | None:
        row = self._context.row
        return 100 * row["juddered"] / row["planned"] if row["planned"] else None

    def _lowered(self) -> list[str]:
        """What the governor has taken away."""
        level = self._context.options.level
        return [f"quality lowered, level {level.number}: {level.words}"] if level else []

    def _map(self) -> NDArray[np.uint8] | None:
        """The grid of views with the eyes in it; the left eye's dot is filled."""
        shown, field = self._viewer.shown, self._viewer.field
        if shown is None:
            return None
        (lx, ly), (rx, ry) = shown.eyes_px.tolist()
        eyes, views = ((lx, ly), (rx, ry)), (shown.left, shown.right)
        return inset(EyesOnGrid(field.rows, field.cols, 0.0, (0.0, 0.0), eyes, views, True), INSET_PX)

    def _depth(self) -> str:
        """The zero plane as a slider between the farthest and the nearest of the scene."""
        field, zero = self._viewer.field, self._context.config.render.zero_plane_px
        low, high = field.disparity_min_px, field.disparity_max_px
        at = min(max(round(20 * (zero - low) / (high - low)), 0), 20) if high > low else 10
        return f"depth [{'-' * at}|{'-' * (20 - at)}] zero plane {zero:+.2f} px/view"

    def _screenshot(self) -> None:
        picture = self._presenter.picture
        if picture is None:
            return
        path = Path(time.strftime("lfpipe-%Y%m%d-%H%M%S.png")).resolve()
        self._context.emit("notice", text=save(path, picture))
