"""Actions of the viewer's keys, and what lies over the picture. Settings go through the supervisor
like all others, so that every stage gets them.

The picture shows every change for a moment, whoever made it.
"""

import os
import subprocess
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import platformdirs

from lfpipe.config import Render, choices, user_file
from lfpipe.config.modes import Window
from lfpipe.config.quality import level_number
from lfpipe.host.files import is_dir
from lfpipe.render.display import Display
from lfpipe.render.file_display import save
from lfpipe.render.geometry import zero_plane_px, zero_planes_px
from lfpipe.render.glasses import GHOST, WORDS, glasses_menu, instructions
from lfpipe.render.mouse_look import MouseLook
from lfpipe.render.notices import SHOWN_NS, Notices, changes, status_lines
from lfpipe.render.open_display import HINT
from lfpipe.render.overlay import CLOSING, DEPTH, HELP, Item, Overlay, bar_items
from lfpipe.render.presenter import Presenter, draw_glasses_test, draw_scene
from lfpipe.render.scenes import NO_DIALOG, NO_OTHER, SceneLoader, ScenePage, file_dialog
from lfpipe.render.viewer import Viewer
from lfpipe.scene.half_turn import remember, undecided
from lfpipe.sequence.packets import PACKETS
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.notices import NO_FACE, notices

ALPHA_STEP = 1.1  # hardly visible at once, twice the movement in seven
GHOST_STEP = 5.0  # %: the least that is seen
MODES = choices("render.anaglyph")
HINT_NS = 6 * SECOND_NS  # a person looks at the scene first
FIGURES_NS = SECOND_NS // 2  # between two readings: faster ones cannot be read
TOUCH = "put on the glasses, and drag over the picture to look around"
INVITATION = "put on the glasses and stand in front of the screen"
ROWS_UNKNOWN = "Wayland hides where this window is: press f, or the eyes may be exchanged"
ASKED_NS = 8 * SECOND_NS  # time to look which is which
RECORDED_NS = 8 * SECOND_NS  # time to read a path


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
        first = not context.row["restarts"]
        # over the picture: "glasses", the question; "test", of the glasses; "scenes"; "help";
        # "figures"; or nothing
        self._over = "glasses" if context.options.ask_glasses and first else ""
        # for the answer, and for the test of the glasses
        self._page_waits = context.options.start and first
        self._before_test = context.config.render
        self._recorded = ""
        self._record_ns = self._record_due_ns = 0
        self._recording = ""
        self._alpha_px = 0.0
        self._figures = tuple[str, ...]()
        self._figures_due_ns = 0
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
            "close": lambda _: self._close(),
            "load": self._load,
            "delete": lambda event: self.page.forget(event.removeprefix("load ")),
            "next": lambda _: self.scenes.step(1),
            "previous": lambda _: self.scenes.step(-1),
            "open": lambda _: self._open(folder=True),
            "open-file": lambda _: self._open(folder=False),
            "which": lambda _: self._switch("glasses"),
            "wear": self._wear,
            "glasses": lambda _: self._switch("test"),
            GHOST: lambda share: self._set(ghost_compensation=round(100 * float(share))),
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
            if word in CLOSING and self._over != "figures":
                self._close()
            if word in self._actions:
                self._actions[word](argument)
        if self._dialog is not None and self._dialog.poll() is not None:
            path = self._dialog.communicate()[0].rstrip("\n")
            self._dialog = None
            if path.strip():  # else it was cancelled
                self.scenes.load(Path(path).absolute())
        t_ns = now_ns()
        self._mouse.follow(self._display.pointer, t_ns)
        self.pass_on_notices()
        # a larger picture has larger parallax
        if self._viewer.shown_as_wide(self._display.width_mm()):
            self._presenter.redraw()
        self.scenes.serve(t_ns)
        if self._over == "scenes":
            self.page.serve(t_ns)
        self._notice_changes()
        self._follow_recording(t_ns)
        self._show_overlay(t_ns)

    def _show_overlay(self, t_ns: int) -> None:
        if self._page_waits and not self._over:
            self._switch("scenes")
        if self._over == "figures" and t_ns >= self._figures_due_ns:
            self._figures = status_lines(self._context, self._viewer)
            self._figures_due_ns = t_ns + FIGURES_NS
            self._presenter.redraw()
        render = self._context.config.render
        lines = {"help": HELP, "figures": self._figures}.get(self._over, ())
        items = tuple[Item, ...]()
        if self._over == "test":
            lines, items = instructions(render)
        menu = self.page.menu() if self._over == "scenes" else None
        if self._over == "glasses":
            menu = glasses_menu(render.anaglyph)
        self._display.overlay(
            Overlay(
                lines=lines,
                items=items,
                notices=self._notices.lines(t_ns, self._standing(t_ns)),
                progress=self.scenes.share,
                menu=menu,
                bar=self._bar(),
                recording=self._recording,
            )
        )

    def _switch(self, over: str) -> None:
        """Puts one thing over the picture; takes it away if it is there."""
        options = self._context.options
        if over == "scenes" and len(options.playlist) < 2 and not options.start:
            self._notices.say("scene", NO_OTHER)
            return
        before = self._over
        self._close()
        if over == before:
            return
        self._over = over
        self._figures_due_ns = 0
        if over == "test":
            self._before_test = self._context.config.render
            self._presenter.draw_by(partial(draw_glasses_test, self._viewer))
        if over == "scenes":
            self._page_waits = False
            self.page.open()

    def _close(self) -> None:
        """Takes away what is over the picture. The changes of a glasses test are kept in the
        person's settings.
        """
        over, self._over = self._over, ""
        if over == "scenes":
            self.page.close()
        if over != "test":
            return
        self._presenter.draw_by(partial(draw_scene, self._viewer))
        now, before = self._context.config.render, self._before_test
        changed = {
            name: getattr(now, name)
            for name in ("swap_eyes", "ghost_compensation")
            if getattr(now, name) != getattr(before, name)
        }
        if changed:
            self._keep(**changed)

    def _load(self, path: str) -> None:
        self._close()
        if path:
            self.scenes.load(Path(path).absolute())
        else:
            self._notices.say(
                "scene", "not loaded: rename it to plain letters, then drop it again", 2 * SHOWN_NS
            )

    def _open(self, folder: bool) -> None:
        self._dialog = self._dialog or file_dialog(folder)
        if self._dialog is None:
            self._notices.say("scene", NO_DIALOG, 2 * SHOWN_NS)

    def _bar(self) -> tuple[Item, ...]:
        options = self._context.options
        field = self._viewer.field
        if options.kiosk:
            return ()
        without = set() if len(options.playlist) > 1 or options.start else {"choose"}
        if not options.viewer.tracked:
            without.add("record")
        if field.rows * field.cols == 1:
            without |= {DEPTH, "half-turn", "recentre", "which"}
        return bar_items(
            self._context.config.render.depth, bool(options.record), frozenset(without)
        )

    # glasses

    def _wear(self, anaglyph: str) -> None:
        """Keeps the answer, and begins the test of these glasses."""
        self._close()
        self._keep(anaglyph=anaglyph)
        self._set(anaglyph=anaglyph)
        if anaglyph != "mono":
            self._switch("test")

    def _compensate_ghost(self, step: float) -> None:
        """During the test: more or less against ghosts."""
        if self._over == "test":
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

    def _follow_recording(self, t_ns: int) -> None:
        """Updates what the window says of a recording, whoever began it."""
        folder = self._context.options.record
        if folder != self._recorded:
            if self._recorded:
                path = Path(self._recorded)
                text = f"the recording is {path.name}\nin {path.parent}"
                words = text if _size_bytes(path) else "no frame was recorded"
                self._notices.say("record", words, RECORDED_NS)
            self._recorded, self._recording = folder, ""
            self._record_ns = self._record_due_ns = t_ns
        if folder and t_ns >= self._record_due_ns:
            self._record_due_ns = t_ns + FIGURES_NS
            minutes, seconds = divmod((t_ns - self._record_ns) // SECOND_NS, 60)
            megabytes = _size_bytes(Path(folder)) / 1e6
            self._recording = f"{minutes}:{seconds:02}  {megabytes:.0f} MB"
            self._presenter.redraw()

    def _screenshot(self) -> None:
        if self._presenter.picture is not None:
            path = _picture_folder() / time.strftime("lfpipe-%Y%m%d-%H%M%S.png")
            text = save(path, self._presenter.picture) or f"picture saved as {path}"
            self._context.emit("notice", text=text)
            self._notices.say("picture", text)

    # notices

    def _ask_about_depth(self) -> None:
        """Says, the first time an undecided scene is shown, how to exchange near and far."""
        context = self._context
        field = self._viewer.field
        on_screen = isinstance(context.options.display, Window) and not context.options.kiosk
        if on_screen and undecided(field, context.config.scene.half_turn):
            self._notices.say("near and far", "press d if near and far are exchanged", ASKED_NS)
            remember(field, "asked")

    def _notice_changes(self) -> None:
        """Shows a notice for each change since the last call."""
        render = self._context.config.render
        level = level_number(self._context.options)
        field = self._viewer.field
        before, level_before, scene_before, half_turned_before = self._known
        self._known = (render, level, field.name, field.half_turned)
        if render is not before:
            plane_px = zero_plane_px(field, before)
            for subject, text in changes(before, render, self._alpha_px, plane_px).items():
                self._notices.say(subject, text)
        if self._viewer.parallax is not None:
            self._alpha_px = self._viewer.parallax.alpha_px
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
        context = self._context
        lines = [self.scenes.words(t_ns)]
        if context.config.render.anaglyph == "row-interleaved" and not self._display.knows_rows:
            lines.append(ROWS_UNKNOWN)
        is_exhibition = bool(context.options.kiosk)
        if context.paused:
            lines.append("paused" if is_exhibition else "paused: p or space resumes")
        told = notices(context.table.rows, context.spec.source, context.spec.name)
        if told and is_exhibition:  # what else it says is for its operator
            is_alone = any(line.startswith(NO_FACE) for line in told)
            told = [INVITATION if is_alone else TOUCH]
        return [*lines, *told]

    def pass_on_notices(self) -> None:
        """Emits the display's notices."""
        for notice in self._display.notices():
            if notice.lost:
                self._context.report_lost(notice.text)
            else:
                self._context.emit("notice", text=notice.text)


def _size_bytes(folder: Path) -> int:
    """Size of a recording's frames."""
    try:
        return (folder / PACKETS).stat().st_size
    except OSError:
        return 0


def _picture_folder() -> Path:
    """The desktop's folder for pictures, or else the working directory."""
    folder = platformdirs.user_pictures_path()
    return (
        folder
        if folder != Path.home() and is_dir(folder) and os.access(folder, os.W_OK)
        else Path.cwd()
    )
