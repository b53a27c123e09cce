"""The action of each event. To add one, add a row here, and a row to `keys.KEYS` if it has a
key.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import platformdirs

from lfpipe.config.modes import Window, is_measurable
from lfpipe.render.display.file_display import save
from lfpipe.render.display.overlay import Event
from lfpipe.render.ui.controller import Ui
from lfpipe.render.ui.glasses import GHOST
from lfpipe.render.ui.keys import DEPTH
from lfpipe.render.ui.notices import SHOWN_NS, VIEWERS
from lfpipe.render.ui.recording import user_folder

Action = Callable[[Ui, Event], None]
ALPHA_FACTOR = 1.1  # hardly visible at once, twice the parallax in seven steps


def _recentre(ui: Ui, _event: Event) -> None:
    ui.context.request("recentre")
    ui.notices.show("centre", "centred where you are")


def _pause(ui: Ui, _event: Event) -> None:
    ui.context.request("resume" if ui.context.paused else "pause")


def _load(ui: Ui, event: Event) -> None:
    ui.close_page()
    if event.text:
        ui.scenes.load(Path(event.text).absolute())
    else:
        text = "the file name cannot be read: rename it to plain letters, then drop it again"
        ui.notices.show("scene", text, 2 * SHOWN_NS)


def _wear(ui: Ui, event: Event) -> None:
    """Stores the answer and starts the glasses test."""
    ui.close_page()
    ui.settings.keep({"anaglyph": event.text})
    ui.settings.set(anaglyph=event.text)
    if event.text != "mono":
        ui.open_page(ui.glasses_test)


def _look(ui: Ui, event: Event) -> None:
    """Asks for another viewer."""
    ui.close_page()
    own = ui.context.config.camera.source
    camera = "" if own.startswith("demo") or own == "mouse" else own
    ui.notices.show("viewer", f"starting: {VIEWERS[event.text].lower()}")
    ui.context.request("viewer", source=camera if event.text == "camera" else event.text)


def _calibrate(ui: Ui, event: Event) -> None:
    """Opens the page, or closes it. With a distance as its value, it opens it there."""
    options = ui.context.options
    if not is_measurable(options.viewer) or not isinstance(options.display, Window):
        ui.notices.show("calibrate", "no camera is in use: press v to choose one")
        return
    if event.value:
        ui.close_page()
        ui.calibration.distance.set(event.value)
    ui.open_page(ui.calibration)


def _save_picture(ui: Ui, _event: Event) -> None:
    picture = ui.presenter.saved_picture()
    if picture is not None:
        path = user_folder(platformdirs.user_pictures_path()) / time.strftime(
            "lfpipe-%Y%m%d-%H%M%S.png"
        )
        text = save(path, picture) or f"picture saved as {path}"
        ui.context.notify(text)
        ui.notices.show("picture", text)


ACTIONS: Mapping[str, Action] = {
    "quit": lambda ui, _: ui.context.request("stop"),
    "recentre": _recentre,
    "freeze": _pause,
    "screenshot": _save_picture,
    # pages
    "overlay": lambda ui, _: ui.open_page(ui.metrics_page),
    "help": lambda ui, _: ui.open_page(ui.help_page),
    "open": lambda ui, _: ui.open_page(ui.folder_page),
    "choose": lambda ui, _: ui.open_page(ui.scene_page),
    "which": lambda ui, _: ui.open_page(ui.glasses_question),
    "who": lambda ui, _: ui.open_page(ui.viewer_page),
    "look": _look,
    "glasses": lambda ui, _: ui.open_page(ui.glasses_test),
    "calibrate": _calibrate,
    "close": lambda ui, _: ui.close_page(),
    # settings
    "mode": lambda ui, _: ui.settings.next_mode(),
    "depth+": lambda ui, _: ui.settings.move_zero_plane(1),
    "depth-": lambda ui, _: ui.settings.move_zero_plane(-1),
    "alpha+": lambda ui, _: ui.settings.scale_alpha(ALPHA_FACTOR),
    "alpha-": lambda ui, _: ui.settings.scale_alpha(1 / ALPHA_FACTOR),
    "automatic": lambda ui, _: ui.settings.automatic(),
    "swap": lambda ui, _: ui.settings.swap_eyes(),
    "invert-depth": lambda ui, _: ui.settings.invert_depth(),
    DEPTH: lambda ui, event: ui.settings.set(alpha_px="auto", depth=event.value),
    # glasses
    "wear": _wear,
    GHOST: lambda ui, event: ui.settings.set(ghost_compensation=round(100 * event.value)),
    # scenes and recordings
    "load": _load,
    **dict.fromkeys(("next", "more"), lambda ui, _: ui.scenes.step(1)),
    **dict.fromkeys(("previous", "less"), lambda ui, _: ui.scenes.step(-1)),
    "record": lambda ui, _: ui.recording.toggle(),
}
