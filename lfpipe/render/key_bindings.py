"""Actions of the viewer's keys. Settings go through the supervisor like all others, so that every stage gets them.

The picture shows every change for a moment, whoever made it.
"""

import math
import os
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Render, choices
from lfpipe.config.quality import level_number
from lfpipe.render.display import BarState, Display
from lfpipe.render.file_dialog import ABSENT, FileDialog
from lfpipe.render.file_display import picture_folder, save
from lfpipe.render.geometry import depth_step_px, zero_plane_px
from lfpipe.render.glasses_help import GlassesHelp
from lfpipe.render.overlay import SHOWN_NS, Notices, StatusOverlay
from lfpipe.render.presenter import Presenter
from lfpipe.render.scene_menu import NO_OTHER, SceneLoader, SceneMenu
from lfpipe.render.viewer import Viewer
from lfpipe.scene.half_turn import remember, undecided
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.status import State

ALPHA_STEP = 1.1
MODES = choices("render.anaglyph")
SETTLED_NS = SECOND_NS // 2  # a resize is over once the width has not changed for this long
OVERLAY_NS = SECOND_NS // 2
FACELESS_NS = 4 * SECOND_NS  # a turned head is no reason for a notice
INVITATION = "put on the glasses and stand in front of the screen"
ASKED_NS = 8 * SECOND_NS
LOST = "camera lost, trying again"


class KeyBindings:
    """Handles a display's events, notices and overlay. scenes, menu: other scenes."""

    def __init__(self, context: Context, viewer: Viewer, presenter: Presenter, display: Display) -> None:
        self._context, self._viewer, self._presenter, self._display = context, viewer, presenter, display
        self._status = StatusOverlay(context, viewer)
        self._notices, self._said = Notices(), [""]
        self.scenes = SceneLoader(context, self._notices)
        self.menu = SceneMenu(context, display, self.scenes)
        self._glasses = GlassesHelp(context, presenter, display, self._notices, self.menu.open)
        self._dialog = FileDialog()
        self._overlay_due_ns = 0
        self._width_mm, self._settled_ns = display.width_mm(), 0
        self._overlay = False
        self._known = (context.config.render, level_number(context.options), viewer.field.name, viewer.field.half_turned)
        self._ask_about_depth()
        first = not context.row["restarts"]
        if context.options.ask_glasses and first:
            self._glasses.ask()
        elif context.options.start and first:
            self.menu.open()

    def serve(self) -> None:
        """Handles the keys since the last call and refreshes notices and overlay."""
        for event in self._display.events():
            self._presenter.redraw()
            if not self._glasses.takes(event) and not self.menu.takes(event):
                self._carry_out(event)
        if (path := self._dialog.chosen()) is not None:
            self.scenes.load(path.absolute())
        self._presenter.mouse.follow(self._display.pointer(), now_ns())
        self.pass_on_notices()
        self._follow_width()
        t_ns = now_ns()
        self.scenes.serve(t_ns)
        self._display.progress(self.scenes.share)
        self.menu.serve(t_ns)
        self._notice_changes(t_ns)
        self._show_bar()
        if (lines := self._notices.lines(t_ns)) != self._said:
            self._said = lines
            self._display.say(lines)
        if self._overlay and t_ns >= self._overlay_due_ns:
            self._overlay_due_ns = t_ns + OVERLAY_NS
            self._display.overlay(self._status.lines(), self._status.map())
            self._presenter.redraw()

    def _carry_out(self, event: str) -> None:
        render = self._context.config.render
        if event == "quit":
            self._context.request("stop")
        elif event == "recentre":
            self._context.request("recentre")
            self._notices.say("centre", "centred where you are", now_ns())
        elif event == "screenshot":
            self._screenshot()
        elif event == "overlay":
            self._overlay, self._overlay_due_ns = not self._overlay, 0
            self._display.overlay([])
        elif event == "freeze":
            self._context.request("resume" if self._context.paused else "pause")
        elif event == "mode":
            self._set(anaglyph=MODES[(MODES.index(render.anaglyph) + 1) % len(MODES)])
        elif event in ("depth+", "depth-"):
            field = self._viewer.field
            step_px = depth_step_px(field.disparity_min_px, field.disparity_max_px)
            moved = round(zero_plane_px(field, render) / step_px) + (1 if event == "depth+" else -1)
            self._set(zero_plane_px=round(moved * step_px, 6))
        elif event in ("alpha+", "alpha-") and self._viewer.parallax is not None:
            step = ALPHA_STEP if event == "alpha+" else 1 / ALPHA_STEP
            self._set(alpha_px=round(self._viewer.parallax.alpha_px * step, 3))
        elif event == "automatic":
            self._set(alpha_px="auto", zero_plane_px=Render().zero_plane_px, depth=Render().depth)
        elif event == "choose":
            self._notices.say("scene", NO_OTHER, now_ns())
        elif event in ("next", "previous"):
            self.scenes.step(1 if event == "next" else -1)
        elif event == "drop":
            self._notices.say("scene", "not loaded: its name is not UTF-8; use `lfpipe ctl load`", now_ns(), 2 * SHOWN_NS)
        elif event.startswith("drop "):
            self.scenes.load(Path(event.removeprefix("drop ")).absolute())
        elif event == "swap":
            self._set(swap_eyes=not render.swap_eyes)
        elif event == "half-turn":
            self._context.request("set", set={"scene.half_turn": "no" if self._viewer.field.half_turned else "yes"})
        elif event.startswith("depth "):
            self._set(alpha_px="auto", depth=float(event.removeprefix("depth ")))
        elif event == "record":
            self._record()
        elif event in ("open", "open-file") and not self._dialog.open(event == "open"):
            self._notices.say("scene", ABSENT, now_ns(), 2 * SHOWN_NS)

    def _ask_about_depth(self) -> None:
        """Says, the first time an undecided scene is shown, how to exchange near and far."""
        context, field = self._context, self._viewer.field
        on_screen = context.options.display in ("window", "fullscreen") and not context.options.kiosk
        if on_screen and undecided(field, context.config.scene.half_turn):
            self._notices.say("near and far", "press d if near and far are exchanged", now_ns(), ASKED_NS)
            remember(field, "asked")

    def _record(self) -> None:
        """Begins or ends a recording of the camera, with the eyes, beside the pictures."""
        if self._context.options.record:
            self._context.request("record", path="")
            return
        path = picture_folder(Path.home(), os.environ) / time.strftime("lfpipe-recording-%Y%m%d-%H%M%S")
        self._context.request("record", path=str(path), eyes=True)
        self._notices.say("record", f"recording to {str(path).replace(str(Path.home()), '~')}", now_ns())

    def _show_bar(self) -> None:
        options = self._context.options
        without = set() if len(options.playlist) > 1 or options.start else {"choose"}
        if not options.tracking:
            without.add("record")
        if self._viewer.field.rows * self._viewer.field.cols == 1:
            without |= {"depth", "half-turn", "recentre", "which"}
        render = self._context.config.render
        depth = 1.0 if render.alpha_px == "true" else render.depth
        self._display.bar(BarState(depth, bool(options.record), frozenset(without)))

    def _set(self, **values: object) -> None:
        self._context.request("set", set={f"render.{name}": value for name, value in values.items()})

    def _notice_changes(self, t_ns: int) -> None:
        """Shows a notice for each change since the last call."""
        context, row = self._context, self._context.row
        field = self._viewer.field
        render, level, scene = context.config.render, level_number(context.options), field.name
        before, level_before, scene_before, half_turned_before = self._known
        if render != before:
            for subject, text in _changes(before, render):
                self._notices.say(subject, text, t_ns)
        if level and not level_before:
            self._notices.say("quality", "busy computer: simpler picture for now", t_ns)
        self._glasses.follow(render)
        if scene != scene_before:
            self._display.title(scene)
            self._notices.say("scene", scene, t_ns)
            self._ask_about_depth()
        elif field.half_turned != half_turned_before:
            self._notices.say("near and far", "near and far exchanged: d exchanges them again", t_ns)
        self._known = (render, level, scene, field.half_turned)
        self._notices.state("paused", "paused: p or space resumes" if context.paused else "")
        lost = int(context.table.rows[context.spec.source]["state"]) == State.READY  # it has no camera
        self._notices.state("camera", LOST if lost else "")
        away_ns = t_ns - row["t_face_ns"]
        faceless = context.options.tracking and not lost and not context.paused and row["t_face_ns"] and away_ns > FACELESS_NS
        words = INVITATION if context.options.kiosk else f"no face for {away_ns // SECOND_NS} s: move into the camera's view"
        self._notices.state("face", words if faceless else "")
        self._notices.state("glasses", self._glasses.words(render))

    def _follow_width(self) -> None:
        """A larger picture has larger parallax: alpha follows once the window keeps its size."""
        width_mm = self._display.width_mm()
        if width_mm != self._width_mm:
            self._width_mm, self._settled_ns = width_mm, now_ns() + SETTLED_NS
        elif now_ns() >= self._settled_ns and self._viewer.shown_as_wide(width_mm):
            self._presenter.redraw()

    def pass_on_notices(self) -> None:
        """Emits the display's notices."""
        for notice in self._display.notices():
            if notice.lost:
                self._context.report_lost(notice.text)
            else:
                self._context.emit("notice", text=notice.text)

    def _screenshot(self) -> None:
        picture: NDArray[np.uint8] | None = self._presenter.picture
        if picture is None:
            return
        folder = picture_folder(Path.home(), os.environ)
        path = folder / time.strftime("lfpipe-%Y%m%d-%H%M%S.png")
        said = save(path, picture) or f"picture saved as {path}"
        self._context.emit("notice", text=said)
        self._notices.say("picture", said.replace(str(Path.home()), "~"), now_ns())


def _changes(before: Render, now: Render) -> list[tuple[str, str]]:
    """(subject, text) of each changed setting that a viewer notices."""
    found = []
    if now.depth != before.depth:
        found.append(("depth", f"depth: {now.depth:.0%} of the way from comfort to true"))
    if now.anaglyph != before.anaglyph:
        found.append(("mode", f"mode: {now.anaglyph}"))
    if now.zero_plane_px != before.zero_plane_px:
        plane = f"{now.zero_plane_px:+.2f} px/view" if not isinstance(now.zero_plane_px, str) else now.zero_plane_px
        found.append(("depth", f"depth: zero plane {plane}"))
    if now.alpha_px != before.alpha_px:
        alpha = f"{now.alpha_px:.1f} px/view" if not isinstance(now.alpha_px, str) else now.alpha_px
        found.append(("alpha", f"head movement: alpha {alpha}"))
    if now.method != before.method:
        found.append(("method", f"views: {now.method}"))
    if now.swap_eyes != before.swap_eyes:
        found.append(("swap", "eyes swapped" if now.swap_eyes else "eyes as they are"))
    if not math.isclose(now.ghost_compensation, before.ghost_compensation):
        found.append(("ghost", f"ghost compensation: {now.ghost_compensation:.0f} %"))
    return found
