"""Actions of the viewer's keys, and what lies over the picture. Settings go through the supervisor
like all others, so that every stage gets them.

The picture shows every change for a moment, whoever made it.
"""

import subprocess
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import attrs

from lfpipe.config import Render, choices, user_file
from lfpipe.config.modes import Window
from lfpipe.config.quality import level_number
from lfpipe.render.display.display import Display
from lfpipe.render.display.file_display import save
from lfpipe.render.display.open_display import HINT
from lfpipe.render.presenter import Presenter
from lfpipe.render.ui.glasses import GHOST, WORDS
from lfpipe.render.ui.notices import SHOWN_NS, Notices, changes
from lfpipe.render.ui.overlay import CLOSING, DEPTH, Item, Overlay, bar_items
from lfpipe.render.ui.pages import GlassesQuestion, GlassesTest, Help, MetricsPage, Page
from lfpipe.render.ui.recording import RecordingIndicator, picture_folder
from lfpipe.render.ui.scenes import NO_DIALOG, NO_OTHER, SceneLoader, ScenePage, file_dialog
from lfpipe.render.viewer.geometry import zero_plane_px, zero_planes_px
from lfpipe.render.viewer.mouse_look import MouseLook
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.scene.inverted_depth import remember, undecided
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.notices import NO_FACE, notices

ALPHA_STEP = 1.1  # hardly visible at once, twice the movement in seven
GHOST_STEP = 5.0  # %: the least that is seen
MODES = choices("render.anaglyph")
HINT_NS = 6 * SECOND_NS  # a person looks at the scene first
TOUCH = "put on the glasses, and drag over the picture to look around"
INVITATION = "put on the glasses and stand in front of the screen"
ROWS_UNKNOWN = "Wayland hides where this window is: press f, or the eyes may be exchanged"
ASKED_NS = 8 * SECOND_NS  # time to look which is which


class KeyBindings:
    """Handles a display's events and notices. scenes: other scenes. page: their pictures."""

    def __init__(
        self,
        context: Context,
        viewer: Viewer,
        presenter: Presenter,
        mouse: MouseLook,
        display: Display,
    ) -> None:
        self._context = context
        self._viewer = viewer
        self._presenter = presenter
        self._mouse = mouse
        self._display = display
        self._notices = Notices()
        self.scenes = SceneLoader(context, self._notices)
        self.page = ScenePage(context)
        # at most one, so that pictures go on meanwhile
        self._dialog: subprocess.Popen[str] | None = None
        self._recording = RecordingIndicator(context, self._notices)
        self._question = GlassesQuestion(context)
        self._test = GlassesTest(context, presenter, self._keep)
        first = not context.row["restarts"]
        # the page over the picture
        self._open: Page | None = self._question if context.options.ask_glasses and first else None
        # the page of scenes comes after the answer, and after the test of the glasses
        self._scenes_wait = context.options.start and first
        self._alpha_px = 0.0
        self._known = (
            context.config.render,
            level_number(context.options),
            viewer.field.name,
            viewer.field.depth_inverted,
        )
        # by an event's first word; the rest of it is the argument
        self._actions: dict[str, Callable[..., None]] = {
            "quit": partial(context.request, "stop"),
            "recentre": self._recentre,
            "screenshot": self._screenshot,
            "overlay": partial(self._switch, MetricsPage(context, viewer, presenter)),
            "help": partial(self._switch, Help()),
            "freeze": lambda: context.request("resume" if context.paused else "pause"),
            "mode": lambda: self._set(
                anaglyph=MODES[(MODES.index(context.config.render.anaglyph) + 1) % len(MODES)]
            ),
            "depth+": partial(self._move_plane, 1),
            "depth-": partial(self._move_plane, -1),
            "alpha+": partial(self._scale_alpha, ALPHA_STEP),
            "alpha-": partial(self._scale_alpha, 1 / ALPHA_STEP),
            "automatic": partial(
                self._set,
                alpha_px="auto",
                zero_plane_px=Render().zero_plane_px,
                depth=Render().depth,
            ),
            "swap": lambda: self._set(swap_eyes=not context.config.render.swap_eyes),
            "invert-depth": lambda: context.request(
                "set", set={"scene.invert_depth": "no" if viewer.field.depth_inverted else "yes"}
            ),
            "record": self._recording.toggle,
            "choose": partial(self._switch, self.page),
            "close": self._close,
            "next": partial(self.scenes.step, 1),
            "previous": partial(self.scenes.step, -1),
            "open": partial(self._ask_for, folder=True),
            "open-file": partial(self._ask_for, folder=False),
            "which": partial(self._switch, self._question),
            "glasses": partial(self._switch, self._test),
            "more": partial(self._compensate_ghost, GHOST_STEP),
            "less": partial(self._compensate_ghost, -GHOST_STEP),
            DEPTH: lambda share: self._set(alpha_px="auto", depth=float(share)),
            GHOST: lambda share: self._set(ghost_compensation=round(100 * float(share))),
            "load": self._load,
            "delete": lambda event: self.page.forget(event.removeprefix("load ")),
            "wear": self._wear,
        }
        if not (context.options.lock_code or self._open or self._scenes_wait):
            self._notices.say("hint", HINT, HINT_NS)
        self._ask_about_depth()
        self._show_overlay(now_ns())  # keys that are pressed now are for the menu

    def serve(self) -> None:
        """Handles the keys since the last call and refreshes what lies over the picture."""
        for event in self._display.events():
            self._presenter.redraw()
            word, *argument = event.split(" ", 1)
            if word in CLOSING and not (self._open and self._open.stays):
                self._close()
            if word in self._actions:
                self._actions[word](*argument)
        if self._dialog is not None and self._dialog.poll() is not None:
            path = self._dialog.communicate()[0].rstrip("\n")
            self._dialog = None
            if path.strip():  # else it was cancelled
                self.scenes.load(Path(path).absolute())
        t_ns = now_ns()
        self._mouse.move(self._display.pointer, t_ns)
        self.pass_on_notices()
        # a larger picture has larger parallax
        if self._viewer.set_width(self._display.width_mm()):
            self._presenter.redraw()
        self.scenes.serve(t_ns)
        self._notice_changes()
        if self._recording.serve(t_ns):
            self._presenter.redraw()
        self._show_overlay(t_ns)

    def _show_overlay(self, t_ns: int) -> None:
        if self._scenes_wait and self._open is None:
            self._switch(self.page)
        self._display.overlay(
            attrs.evolve(
                self._open.overlay(t_ns) if self._open else Overlay(),
                notices=self._notices.lines(t_ns, self._standing(t_ns)),
                progress=self.scenes.share,
                bar=self._bar(),
                recording=self._recording.words,
            )
        )

    def _switch(self, page: Page) -> None:
        """Opens a page in place of another; closes it if it is open."""
        options = self._context.options
        if page is self.page and len(options.playlist) < 2 and not options.start:
            self._notices.say("scene", NO_OTHER)
            return
        before = self._open
        self._close()
        if page is not before:
            self._scenes_wait = self._scenes_wait and page is not self.page
            self._open = page
            page.open()

    def _close(self) -> None:
        page = self._open
        self._open = None
        if page is not None:
            page.close()

    def _load(self, path: str = "") -> None:
        self._close()
        if path:
            self.scenes.load(Path(path).absolute())
        else:
            self._notices.say(
                "scene",
                "the file is not loaded: rename it to plain letters, then drop it again",
                2 * SHOWN_NS,
            )

    def _ask_for(self, folder: bool) -> None:
        self._dialog = self._dialog or file_dialog(folder)
        if self._dialog is None:
            self._notices.say("scene", NO_DIALOG, 2 * SHOWN_NS)

    def _bar(self) -> tuple[Item, ...]:
        options = self._context.options
        field = self._viewer.field
        if options.lock_code:
            return ()
        without = set() if len(options.playlist) > 1 or options.start else {"choose"}
        if not options.viewer.tracked:
            without.add("record")
        if field.rows * field.cols == 1:
            without |= {DEPTH, "invert-depth", "recentre", "which"}
        return bar_items(
            self._context.config.render.depth,
            bool(options.record),
            self._context.paused,
            frozenset(without),
        )

    # glasses

    def _wear(self, anaglyph: str) -> None:
        """Keeps the answer, and begins the test of these glasses."""
        self._close()
        self._keep({"anaglyph": anaglyph})
        self._set(anaglyph=anaglyph)
        if anaglyph != "mono":
            self._switch(self._test)

    def _compensate_ghost(self, step: float) -> None:
        """During the test: more or less against ghosts."""
        if self._open is self._test:
            ghost = self._context.config.render.ghost_compensation + step
            self._set(ghost_compensation=min(max(ghost, 0.0), 100.0))

    def _keep(self, values: dict[str, float | bool | str]) -> None:
        """Saves keys of [render] in the person's settings."""
        if not values:
            return
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

    def _screenshot(self) -> None:
        if self._presenter.picture is not None:
            path = picture_folder() / time.strftime("lfpipe-%Y%m%d-%H%M%S.png")
            text = save(path, self._presenter.picture) or f"picture saved as {path}"
            self._context.emit("notice", text=text)
            self._notices.say("picture", text)

    # notices

    def _ask_about_depth(self) -> None:
        """Says, the first time an undecided scene is shown, how to exchange near and far."""
        options = self._context.options
        field = self._viewer.field
        on_screen = isinstance(options.display, Window) and not options.lock_code
        if on_screen and undecided(field, self._context.config.scene.invert_depth):
            self._notices.say("near and far", "press d if near and far are exchanged", ASKED_NS)
            remember(field, "asked")

    def _notice_changes(self) -> None:
        """Shows a notice for each change since the last call."""
        render = self._context.config.render
        level = level_number(self._context.options)
        field = self._viewer.field
        before, level_before, scene_before, depth_inverted_before = self._known
        self._known = (render, level, field.name, field.depth_inverted)
        if render is not before:
            texts = changes(before, render, self._alpha_px, zero_plane_px(field, before))
            for subject, text in texts.items():
                self._notices.say(subject, text)
        if self._viewer.parallax is not None:
            self._alpha_px = self._viewer.parallax.alpha_px
        if level and not level_before:
            self._notices.say("quality", "busy computer: simpler picture for now")
        if field.name != scene_before:
            self._display.title(field.name)
            self._notices.say("scene", field.name)
            self._ask_about_depth()
        elif field.depth_inverted != depth_inverted_before:
            self._notices.say("near and far", "near and far are exchanged: d exchanges them again")

    def _standing(self, t_ns: int) -> list[str]:
        """The notices that stay as long as they are true."""
        context = self._context
        lines = [self.scenes.words(t_ns)]
        if context.config.render.anaglyph == "row-interleaved" and not self._display.knows_rows:
            lines.append(ROWS_UNKNOWN)
        is_exhibition = bool(context.options.lock_code)
        if context.paused:
            lines.append("paused" if is_exhibition else "paused: p or space resumes")
        current = notices(context.table.rows, context.spec.source, context.spec.name)
        if current and is_exhibition:  # the notices themselves are for its operator
            is_alone = any(line.startswith(NO_FACE) for line in current)
            current = [INVITATION if is_alone else TOUCH]
        return [*lines, *current]

    def pass_on_notices(self) -> None:
        """Emits the display's notices."""
        for notice in self._display.notices():
            if notice.lost:
                self._context.report_lost(notice.text)
            else:
                self._context.emit("notice", text=notice.text)
