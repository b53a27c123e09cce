"""Actions of the viewer's keys, and what lies over the picture. Settings go through the supervisor like all others, so that every
stage gets them.

The picture shows every change for a moment, whoever made it.
"""

import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import platformdirs

from lfpipe.config import Render, choices, user_file
from lfpipe.config.quality import level_number
from lfpipe.host.files import is_dir
from lfpipe.render.display import HINT, Display
from lfpipe.render.file_display import save
from lfpipe.render.geometry import zero_plane_px, zero_planes_px
from lfpipe.render.glasses import WORDS, glasses_menu, instructions
from lfpipe.render.notices import SHOWN_NS, Notices, changes, status_lines
from lfpipe.render.overlay import DEPTH, HELP, Item, Overlay, bar_items
from lfpipe.render.presenter import Presenter
from lfpipe.render.scenes import NO_DIALOG, NO_OTHER, SceneLoader, ScenePage, file_dialog
from lfpipe.render.viewer import Viewer
from lfpipe.scene.half_turn import remember, undecided
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.status import State

ALPHA_STEP = 1.1  # hardly visible at once, twice the movement in seven
GHOST_STEP = 5.0  # %: the least that is seen
MODES = choices("render.anaglyph")
HINT_NS = 6 * SECOND_NS  # a person looks at the scene first
FIGURES_NS = SECOND_NS // 2  # between two readings: faster ones cannot be read
FACELESS_NS = 4 * SECOND_NS  # a turned head is no reason for a notice
INVITATION = "put on the glasses and stand in front of the screen"
ASKED_NS = 8 * SECOND_NS  # time to look which is which


class KeyBindings:
    """Handles a display's events and notices. scenes: other scenes."""

    def __init__(
        self, context: Context, viewer: Viewer, presenter: Presenter, display: Display
    ) -> None:
        self._context, self._viewer, self._presenter, self._display = (
            context,
            viewer,
            presenter,
            display,
        )
        self._notices = Notices()
        self.scenes = SceneLoader(context, self._notices)
        self._page = ScenePage(context)
        self._dialog: subprocess.Popen[str] | None = (
            None  # at most one, so that pictures go on meanwhile
        )
        first = not context.row["restarts"]
        # over the picture: "glasses", the question; "scenes"; "help"; "figures"; or nothing
        self._over = "glasses" if context.options.ask_glasses and first else ""
        self._page_waits = (
            context.options.start and first
        )  # for the answer, and for the test of the glasses
        self._before_test = context.config.render
        self._figures, self._figures_due_ns = tuple[str, ...](), 0
        self._known = (
            context.config.render,
            level_number(context.options),
            viewer.field.name,
            viewer.field.half_turned,
        )
        self._actions: dict[str, Callable[[str], None]] = {
            "quit": lambda _: context.request("stop"),
            "recentre": lambda _: self._recentre(),
            "screenshot": lambda _: self._screenshot(),
            "overlay": lambda _: self._switch("figures"),
            "help": lambda _: self._switch("help"),
            "freeze": lambda _: context.request("resume" if context.paused else "pause"),
            "mode": lambda _: self._set(
                anaglyph=MODES[(MODES.index(context.config.render.anaglyph) + 1) % len(MODES)]
            ),
            "depth+": lambda _: self._move_plane(1),
            "depth-": lambda _: self._move_plane(-1),
            "alpha+": lambda _: self._scale_alpha(ALPHA_STEP),
            "alpha-": lambda _: self._scale_alpha(1 / ALPHA_STEP),
            "automatic": lambda _: self._set(
                alpha_px="auto", zero_plane_px=Render().zero_plane_px, depth=Render().depth
            ),
            DEPTH: lambda share: self._set(alpha_px="auto", depth=float(share)),
            "swap": lambda _: self._set(swap_eyes=not context.config.render.swap_eyes),
            "half-turn": lambda _: context.request(
                "set", set={"scene.half_turn": "no" if viewer.field.half_turned else "yes"}
            ),
            "record": lambda _: self._record(),
            "choose": lambda _: self._switch("scenes"),
            "close": lambda _: self._switch(""),
            "load": self._load,
            "delete": lambda event: self._page.forget(event.removeprefix("load ")),
            "next": lambda _: self.scenes.step(1),
            "previous": lambda _: self.scenes.step(-1),
            "open": lambda _: self._open(folder=True),
            "open-file": lambda _: self._open(folder=False),
            "which": lambda _: self._switch("glasses"),
            "wear": self._wear,
            "glasses": lambda _: self._test_glasses(),
            "more": lambda _: self._compensate_ghost(GHOST_STEP),
            "less": lambda _: self._compensate_ghost(-GHOST_STEP),
        }
        if not (context.options.kiosk or self._over or self._page_waits):
            self._notices.say("hint", HINT, HINT_NS)
        self._ask_about_depth()
        self._show_overlay(now_ns())  # keys that are pressed now are for the menu

    def serve(self) -> None:
        """Handles the keys since the last call and refreshes what lies over the picture."""
        for event in self._display.events():
            self._presenter.redraw()
            word, _, argument = event.partition(" ")
            if word in self._actions:
                self._actions[word](argument)
        if self._dialog is not None and self._dialog.poll() is not None:
            path, self._dialog = self._dialog.communicate()[0].rstrip("\n"), None
            if path.strip():  # else it was cancelled
                self.scenes.load(Path(path).absolute())
        t_ns = now_ns()
        self._presenter.mouse.follow(self._display.pointer, t_ns)
        self.pass_on_notices()
        if self._viewer.shown_as_wide(
            self._display.width_mm()
        ):  # a larger picture has larger parallax
            self._presenter.redraw()
        self.scenes.serve(t_ns)
        if self._over == "scenes":
            self._page.serve(t_ns)
        self._notice_changes()
        self._show_overlay(t_ns)

    def _show_overlay(self, t_ns: int) -> None:
        if self._page_waits and not self._over and not self._presenter.tests_glasses:
            self._switch("scenes")
        if self._over == "figures" and t_ns >= self._figures_due_ns:
            self._figures, self._figures_due_ns = (
                status_lines(self._context, self._viewer),
                t_ns + FIGURES_NS,
            )
            self._presenter.redraw()
        lines = {"help": HELP, "figures": self._figures}.get(self._over, ())
        menu = self._page.menu() if self._over == "scenes" else None
        if self._over == "glasses":
            menu = glasses_menu(self._context.config.render.anaglyph)
        notices = self._notices.lines(t_ns, self._standing(t_ns))
        self._display.overlay(Overlay(lines, None, notices, self.scenes.share, menu, self._bar()))

    def _switch(self, over: str) -> None:
        """Puts one thing over the picture; takes it away if it is there."""
        options = self._context.options
        if over == "scenes" and len(options.playlist) < 2 and not options.start:
            self._notices.say("scene", NO_OTHER)
            return
        self._page.close()
        self._over, self._figures_due_ns = "" if over == self._over else over, 0
        if self._over == "scenes":
            self._page_waits = False
            self._page.open()

    def _load(self, path: str) -> None:
        self._switch("")
        if path:
            self.scenes.load(Path(path).absolute())
        else:
            self._notices.say(
                "scene", "not loaded: its name is not UTF-8; use `lfpipe ctl load`", 2 * SHOWN_NS
            )

    def _open(self, folder: bool) -> None:
        self._dialog = self._dialog or file_dialog(folder)
        if self._dialog is None:
            self._notices.say("scene", NO_DIALOG, 2 * SHOWN_NS)

    def _bar(self) -> tuple[Item, ...]:
        options, field = self._context.options, self._viewer.field
        if options.kiosk:
            return ()
        without = set() if len(options.playlist) > 1 or options.start else {"choose"}
        if not options.tracking:
            without.add("record")
        if field.rows * field.cols == 1:
            without |= {DEPTH, "half-turn", "recentre", "which"}
        return bar_items(
            self._context.config.render.depth, bool(options.record), frozenset(without)
        )

    # glasses

    def _wear(self, anaglyph: str) -> None:
        """Keeps the answer, and begins the test of these glasses."""
        self._switch("")
        self._keep(anaglyph=anaglyph)
        self._set(anaglyph=anaglyph)
        if anaglyph != "mono" and not self._presenter.tests_glasses:
            self._test_glasses()

    def _test_glasses(self) -> None:
        """Begins or ends the test; at its end the changes are kept in the person's settings."""
        self._switch("")
        render, before, ends = (
            self._context.config.render,
            self._before_test,
            self._presenter.tests_glasses,
        )
        self._presenter.tests_glasses, self._before_test = not ends, render
        if ends:
            names = ("swap_eyes", "ghost_compensation")
            if changed := {
                name: getattr(render, name)
                for name in names
                if getattr(render, name) != getattr(before, name)
            }:
                self._keep(**changed)

    def _compensate_ghost(self, step: float) -> None:
        """During the test: more or less against ghosts."""
        if self._presenter.tests_glasses:
            ghost = self._context.config.render.ghost_compensation + step
            self._set(ghost_compensation=min(max(ghost, 0.0), 100.0))

    def _keep(self, **values: float | bool | str) -> None:
        """Saves keys of [render] in the person's settings."""
        from lfpipe.config.user_files import write_keys  # few sessions need it

        try:
            write_keys(user_file(), "render", values)
        except (OSError, ValueError) as error:
            self._notices.say(
                "kept", f"{user_file()}: not saved: {getattr(error, 'strerror', None) or error}"
            )
        else:
            self._notices.say(
                "kept", f"saved for the next session: {', '.join(WORDS[name] for name in values)}"
            )

    # settings

    def _set(self, **values: object) -> None:
        self._context.request(
            "set", set={f"render.{name}": value for name, value in values.items()}
        )

    def _recentre(self) -> None:
        self._context.request("recentre")
        self._notices.say("centre", "centred where you are")

    def _move_plane(self, sign: int) -> None:
        field = self._viewer.field
        *_, step_px = zero_planes_px(field.disparity_min_px, field.disparity_max_px)
        number = round(zero_plane_px(field, self._context.config.render) / step_px) + sign
        self._set(zero_plane_px=round(number * step_px, 6))

    def _scale_alpha(self, factor: float) -> None:
        if self._viewer.parallax is not None:
            self._set(alpha_px=round(self._viewer.parallax.alpha_px * factor, 3))

    # files

    def _record(self) -> None:
        """Begins or ends a recording of the camera, with the eyes, beside the pictures."""
        if self._context.options.record:
            self._context.request("record", path="")
            return
        path = _picture_folder() / time.strftime("lfpipe-recording-%Y%m%d-%H%M%S")
        self._context.request("record", path=str(path))
        self._notices.say("record", f"recording to {path}")

    def _screenshot(self) -> None:
        if self._presenter.picture is not None:
            path = _picture_folder() / time.strftime("lfpipe-%Y%m%d-%H%M%S.png")
            text = save(path, self._presenter.picture) or f"picture saved as {path}"
            self._context.emit("notice", text=text)
            self._notices.say("picture", text)

    # notices

    def _ask_about_depth(self) -> None:
        """Says, the first time an undecided scene is shown, how to exchange near and far."""
        context, field = self._context, self._viewer.field
        on_screen = (
            context.options.display in ("window", "fullscreen") and not context.options.kiosk
        )
        if on_screen and undecided(field, context.config.scene.half_turn):
            self._notices.say("near and far", "press d if near and far are exchanged", ASKED_NS)
            remember(field, "asked")

    def _notice_changes(self) -> None:
        """Shows a notice for each change since the last call."""
        render, level, field = (
            self._context.config.render,
            level_number(self._context.options),
            self._viewer.field,
        )
        before, level_before, scene_before, half_turned_before = self._known
        self._known = (render, level, field.name, field.half_turned)
        for subject, text in changes(before, render).items() if render is not before else ():
            self._notices.say(subject, text)
        if level and not level_before:
            self._notices.say("quality", "busy computer: simpler picture for now")
        if field.name != scene_before:
            self._display.title(field.name)
            self._notices.say("scene", field.name)
            self._ask_about_depth()
        elif field.half_turned != half_turned_before:
            self._notices.say("near and far", "near and far exchanged: d exchanges them again")

    def _standing(self, t_ns: int) -> list[str]:
        """The notices that stay as long as they are true."""
        context, t_face_ns = self._context, int(self._context.row["t_face_ns"])
        lines = [self.scenes.words(t_ns)]
        if self._presenter.tests_glasses:
            lines.append(instructions(context.config.render))
        if context.paused:
            lines.append("paused: p or space resumes")
        if int(context.table.rows[context.spec.source]["state"]) == State.READY:  # it has no camera
            lines.append("camera lost, trying again")
        elif context.options.tracking and t_face_ns and t_ns - t_face_ns > FACELESS_NS:
            words = f"no face for {(t_ns - t_face_ns) // SECOND_NS} s: move into the camera's view"
            lines.append(INVITATION if context.options.kiosk else words)
        return lines

    def pass_on_notices(self) -> None:
        """Emits the display's notices."""
        for notice in self._display.notices():
            if notice.lost:
                self._context.report_lost(notice.text)
            else:
                self._context.emit("notice", text=notice.text)


def _picture_folder() -> Path:
    """The desktop's folder for pictures, or else the working directory."""
    folder = platformdirs.user_pictures_path()
    return (
        folder
        if folder != Path.home() and is_dir(folder) and os.access(folder, os.W_OK)
        else Path.cwd()
    )
