"""What the viewer's keys do: settings go through the supervisor, like everybody's, so that all know of them."""

from __future__ import annotations

import time
from pathlib import Path

import cv2

from lfpipe.render.display import Display
from lfpipe.render.presenter import Presenter
from lfpipe.render.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import rate_hz

ALPHA_STEP = 1.1
OVERLAY_NS = SECOND_NS // 2


class Keys:
    """Serves a display's events and its overlay."""

    def __init__(self, context: Context, viewer: Viewer, presenter: Presenter, display: Display) -> None:
        self._context, self._viewer, self._presenter, self._display = context, viewer, presenter, display
        self._overlay_due_ns = 0
        self._overlay = False

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
                self._display.overlay([])
            elif event in ("alpha+", "alpha-") and self._viewer.parallax is not None:
                step = ALPHA_STEP if event == "alpha+" else 1 / ALPHA_STEP
                self._context.request("set", set={"render.alpha_px": round(self._viewer.parallax.alpha_px * step, 3)})
        self.pass_on_notices()
        if self._overlay and now_ns() >= self._overlay_due_ns:
            self._overlay_due_ns = now_ns() + OVERLAY_NS
            self._display.overlay(self._lines())
            self._presenter.redraw()

    def pass_on_notices(self) -> None:
        """Tells what the display has to say."""
        for notice in self._display.notices():
            self._context.emit("notice", text=notice)

    def _lines(self) -> list[str]:
        rows = self._context.table.rows
        age, alpha = summary_ms(rows["render"]["age"]), self._viewer.parallax
        busy = {name: (summary_ms(row["busy"])["p50_ms"], int(row["drops"])) for name, row in rows.items()}
        return [
            f"camera {rate_hz(rows['capture']):5.1f} Hz   pictures {rate_hz(rows['render']):5.1f} Hz",
            f"sensor to screen p50 {age['p50_ms']:.1f} ms, p99 {age['p99_ms']:.1f} ms",
            *(f"{name} busy p50 {p50_ms:.2f} ms, dropped {drops}" for name, (p50_ms, drops) in busy.items()),
            f"{self._viewer.method}, alpha {alpha.alpha_px:.1f} px/view" if alpha else f"{self._viewer.method}, no face seen yet",
        ]

    def _screenshot(self) -> None:
        picture = self._presenter.picture
        if picture is None:
            return
        path = Path(time.strftime("lfpipe-%Y%m%d-%H%M%S.png")).resolve()
        saved = cv2.imwrite(str(path), picture)
        self._context.emit("notice", text=f"picture saved as {path}" if saved else f"{path}: cannot be written")
