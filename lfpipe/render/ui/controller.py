"""The user interface of the window: the open page, the overlay, and one dispatch for all events.

What an event does is a row of ACTIONS, or a page of `Ui.pages`. Settings are requests to the
supervisor, so every stage gets a change; files and folders are read and written in a thread, so
nothing here waits for a disk.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import attrs
import platformdirs

from lfpipe.config import Render, choices
from lfpipe.config.session_options import Window, is_measurable
from lfpipe.render.display.display import (
    CLOSING,
    DEPTH,
    HELP,
    HINT,
    VIEWERS,
    Display,
    Event,
    Item,
    Notice,
    Overlay,
    Pointer,
    bar_items,
)
from lfpipe.render.display.file_display import save
from lfpipe.render.presenter import Presenter
from lfpipe.render.ui.pages import (
    GHOST,
    CalibrationPage,
    GlassesTest,
    Page,
    glasses_menu,
    metrics_page,
    viewer_menu,
)
from lfpipe.render.ui.scenes import FolderPage, SceneLoader, ScenePage, caption
from lfpipe.render.ui.settings import (
    QUESTION_NS,
    RECORDED_FACE,
    SHOWN_NS,
    USE_CAMERA,
    USE_MOUSE,
    Files,
    Notices,
    RecordingIndicator,
    Settings,
    for_window,
    short,
    standing_notices,
    user_folder,
    viewer_kind,
    viewer_name,
)
from lfpipe.render.viewer.mouse_look import STEP, MouseLook
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.scene.pack import DEMOS
from lfpipe.transport.context import Context
from lfpipe.transport.control import Answer
from lfpipe.transport.ring import now_ns

MODES = choices("render.anaglyph")
DEFAULT = Render()
TURNS = Item("◀", Event("previous")), Item("▶", Event("next"))  # of a locked window
NEEDS_VIEWS = DEPTH, "invert-depth", "recentre", "which"


class Ui:
    """Handles the events of a display and its overlay."""

    def __init__(
        self,
        context: Context,
        viewer: Viewer,
        presenter: Presenter,
        mouse: MouseLook,
        display: Display,
        files: Files,
    ) -> None:
        self.context = context
        self.viewer = viewer
        self.presenter = presenter
        self.notices = Notices()
        self.files = files
        self.settings = Settings(context, viewer, self.notices, files)
        self.scenes = SceneLoader(context, self.notices)
        self.recording = RecordingIndicator(context, self.notices)
        self.calibration = CalibrationPage(context, presenter, files)
        self.pages = {
            "overlay": metrics_page(context, viewer, presenter),
            "help": Page(lambda _: Overlay(title="Keys and mouse", lines=HELP)),
            "open": FolderPage(context, files),
            "choose": ScenePage(context, files),
            "which": Page(lambda _: Overlay(menu=glasses_menu(context.config.render.anaglyph))),
            "who": Page(lambda _: Overlay(menu=viewer_menu(viewer_kind(context.options.viewer)))),
            "glasses": GlassesTest(context, presenter, self.settings),
        }
        """By the actions that open them."""
        self._mouse = mouse
        self._pointer = Pointer()
        self._display = display
        self._overlay = Overlay()
        self.dismissed = False
        options, first = context.options, not context.row["restarts"]
        self.page = self.pages["which"] if options.ask_glasses and first else None
        """The page over the picture."""
        # opens after the question and the test of the glasses
        self._waiting: Page | None = self.calibration if options.calibrate_mm and first else None
        if options.start and first:
            self._waiting = self.pages["choose"]
        if not (options.lock_code or self.page or self._waiting):
            self.notices.show("hint", HINT, QUESTION_NS)
        self.settings.show_doubts()
        self._set_overlay(now_ns())  # keys that are pressed now are for the menu

    def serve(self) -> None:
        """Handles the events since the last call and updates the overlay."""
        for _ in range(16):  # more than a person presses between two refreshes
            events = self._display.events()
            t_ns = now_ns()
            pointer = self._display.pointer
            if pointer != self._pointer or pointer.wheel:  # else a client may have moved it
                self._pointer = pointer
                self._mouse.move(pointer, t_ns)
            if not events:
                break
            for event in events:
                self._do(event)
            self._set_overlay(t_ns)  # the next key may be for the page that this one opened
        for error in self.files.serve():
            self.notices.show("refused", for_window(error.message, error.remedy), QUESTION_NS)
        self.pass_on_notices()
        # a larger picture has larger parallax
        if self.viewer.set_width(self._display.width_mm()):
            self.presenter.redraw()
        self.scenes.serve(t_ns)
        if self.settings.show_changes():
            self._display.title(self.viewer.field.name)
        self.recording.update(t_ns)
        self._set_overlay(t_ns)

    def act(self, name: str, value: float = 0.0) -> str:
        """Does what the key of an action does, and returns what the window says to it."""
        before = self.notices.newest
        self._do(Event(name, value=value))
        if self.page is self.pages["glasses"]:
            return self.page.overlay(now_ns()).lines[0]
        newest = self.notices.newest
        return "" if newest is before or newest is None else newest.text

    def _do(self, event: Event) -> None:
        self.presenter.redraw()
        if self.page is not None and self.page.handle(event):
            return
        if event.name in CLOSING and not (self.page and self.page.stays):
            self.close_page()
        if event.name in self.pages:
            self.open_page(self.pages[event.name])
        elif event.name in ACTIONS:
            ACTIONS[event.name](self, event)

    def handle(self, answer: Answer) -> None:
        """Handles the answer to a request of the window."""
        match answer.cmd:
            case "set":  # applied now, or refused
                del self.settings.requested[:1]
            case "record":
                self.recording.is_requested = False
            case "load":
                self.scenes.handle(answer)
        if not answer.ok and not answer.values.get("replaced"):
            way_out = (USE_MOUSE,) * (answer.cmd == "viewer")
            self.notices.show(
                "refused", for_window(answer.error, answer.remedy), QUESTION_NS, way_out
            )
        elif answer.cmd == "viewer":
            kind = viewer_kind(self.context.options.viewer)
            self.notices.show(
                "viewer",
                "Move the mouse to look around"
                if kind == "mouse"
                else f"Viewer: {VIEWERS.get(kind, '')}",
            )
        elif answer.cmd == "keep":
            self.calibration.is_stored = True

    def open_page(self, page: Page) -> None:
        """Opens a page instead of the current one; closes it if it is open."""
        before = self.page
        self.close_page()
        if page is not before:
            self._waiting = None if page is self._waiting else self._waiting
            self.page = page
            page.open()

    def close_page(self) -> None:
        """Closes the open page."""
        page, self.page = self.page, None
        if page is not None:
            page.close()

    def pass_on_notices(self) -> None:
        """Emits the display's notices."""
        notice, self._display.notice = self._display.notice, None
        if notice is not None:
            (self.context.report_lost if notice.lost else self.context.notify)(notice.text)

    def _set_overlay(self, t_ns: int) -> None:
        if self._waiting is not None and self.page is None:
            self.open_page(self._waiting)
        options, name = self.context.options, self.viewer.field.name
        display, is_locked = options.display, bool(options.lock_code)
        standing = [
            Notice(self.scenes.opening),
            *standing_notices(self.context, self._display.knows_rows),
        ]
        is_demo = viewer_kind(options.viewer) == "demo" and name in DEMOS
        is_quiet = is_locked or self.dismissed or self.page is not None
        if is_demo and isinstance(display, Window) and not is_quiet:
            standing.append(RECORDED_FACE)
        page = self.page.overlay(t_ns) if self.page else Overlay()
        if is_locked:
            page = self._caption(standing)
        overlay = attrs.evolve(
            page,
            notices=() if is_locked else self.notices.current(t_ns, standing),
            scene=display.title if is_locked and isinstance(display, Window) else name,
            step="" if is_locked else self.scenes.working,
            progress=self.scenes.progress,
            viewer=viewer_name(options.viewer),
            bar=self._bar(),
            recording=self.recording.status,
        )
        if overlay != self._overlay:  # what moves is drawn at every refresh
            self._overlay = overlay
            self.presenter.changed_ns = t_ns
        self._display.overlay(overlay)

    def _caption(self, standing: list[Notice]) -> Overlay:
        """What visitors see in a locked window."""
        options = self.context.options
        scene = Path(options.playlist[options.playlist_at])
        several = len(options.playlist) > 1
        return Overlay(
            caption=(
                *caption(scene, self.viewer.field.name),
                *(notice.text for notice in standing),
            ),
            items=TURNS if several else (),
            elapsed=self.scenes.elapsed if several and options.every_s else None,
        )

    def _bar(self) -> tuple[Item, ...]:
        options = self.context.options
        if options.lock_code:
            return ()
        without = {}
        if not options.viewer.tracked:
            without["record"] = "needs a camera"
        if viewer_kind(options.viewer) != "camera":
            without["calibrate"] = "needs a camera"
        if self.viewer.field.rows * self.viewer.field.cols == 1:
            without |= dict.fromkeys(NEEDS_VIEWS, "the scene is one view")
        return bar_items(
            self.context.config.render.depth,
            bool(options.record),
            self.context.paused,
            tuple(without.items()),
        )


# The action of each event. To add one, add a row here, and a row to `display.KEYS` if it has a
# key.

Action = Callable[[Ui, Event], None]


def _recentre(ui: Ui, _event: Event) -> None:
    ui.context.request("recentre")
    ui.notices.show("centre", "Centred where you are")


def _load(ui: Ui, event: Event) -> None:
    ui.close_page()
    if event.text:
        ui.scenes.load(Path(event.text).absolute())
    else:
        text = "The file's name cannot be read: rename it to plain letters, then drop it again"
        ui.notices.show("scene", text, 2 * SHOWN_NS)


def _next_mode(ui: Ui, _event: Event) -> None:
    at = MODES.index(ui.settings.render.anaglyph)
    ui.settings.set(anaglyph=MODES[(at + 1) % len(MODES)])


def _dismiss(ui: Ui, _event: Event) -> None:
    ui.dismissed = True


def _wear(ui: Ui, event: Event) -> None:
    """Stores the answer and starts the glasses test."""
    ui.close_page()
    ui.settings.store({"anaglyph": event.text})
    ui.settings.set(anaglyph=event.text)
    if event.text != "mono":
        ui.open_page(ui.pages["glasses"])


def _look(ui: Ui, event: Event) -> None:
    """Asks for another viewer."""
    ui.close_page()
    own = ui.context.config.camera.source
    camera = "" if own.startswith("demo") or own == "mouse" else own
    ui.notices.show("viewer", f"Starting the {VIEWERS[event.text].lower()} ...")
    ui.context.request("viewer", source=camera if event.text == "camera" else event.text)


def _calibrate(ui: Ui, event: Event) -> None:
    """Opens the page, or closes it. With a distance as its value, it opens it there."""
    options = ui.context.options
    if not is_measurable(options.viewer) or not isinstance(options.display, Window):
        ui.notices.show("calibrate", "No camera is in use", QUESTION_NS, (USE_CAMERA,))
        return
    if event.value:
        ui.close_page()
        ui.calibration.distance.set(event.value / 10)
    ui.open_page(ui.calibration)


def _save_picture(ui: Ui, _event: Event) -> None:
    picture = ui.presenter.saved_picture()
    if picture is not None:
        path = user_folder(platformdirs.user_pictures_path()) / time.strftime(
            "lfpipe-%Y%m%d-%H%M%S.png"
        )
        failed = save(path, picture)
        ui.context.notify(failed or f"picture saved as {path}")
        ui.notices.show(
            "picture", for_window(failed) if failed else f"Picture saved: {short(path)}"
        )


ACTIONS: Mapping[str, Action] = {
    "quit": lambda ui, _: ui.context.request("stop"),
    "recentre": _recentre,
    "freeze": lambda ui, _: ui.context.request("resume" if ui.context.paused else "pause"),
    "screenshot": _save_picture,
    # pages
    "look": _look,
    "calibrate": _calibrate,
    "close": lambda ui, _: ui.close_page(),
    "dismiss": _dismiss,
    # settings
    "mode": _next_mode,
    "depth+": lambda ui, _: ui.settings.move_zero_plane(1),
    "depth-": lambda ui, _: ui.settings.move_zero_plane(-1),
    "alpha+": lambda ui, _: ui.settings.scale_alpha(STEP),
    "alpha-": lambda ui, _: ui.settings.scale_alpha(1 / STEP),
    "automatic": lambda ui, _: ui.settings.set(
        alpha_px="auto", zero_plane_px=DEFAULT.zero_plane_px, depth=DEFAULT.depth
    ),
    "swap": lambda ui, _: ui.settings.set(swap_eyes=not ui.settings.render.swap_eyes),
    "invert-depth": lambda ui, _: ui.settings.request(
        {"scene.invert_depth": "no" if ui.viewer.field.depth_inverted else "yes"}
    ),
    DEPTH: lambda ui, event: ui.settings.set(alpha_px="auto", depth=event.value),
    # glasses
    "wear": _wear,
    GHOST: lambda ui, event: ui.settings.set(ghost_compensation=round(100 * event.value)),
    # scenes and recordings
    "load": _load,
    "show-one": lambda ui, event: ui.context.request(
        "load", scene=event.text, layout="picture"
    ),  # of a folder
    **dict.fromkeys(("next", "more"), lambda ui, _: ui.scenes.step(1)),
    **dict.fromkeys(("previous", "less"), lambda ui, _: ui.scenes.step(-1)),
    "record": lambda ui, _: ui.recording.toggle(),
}
