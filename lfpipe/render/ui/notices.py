"""Notices over the picture, and the lines of key o: rates, latency, depth and the views on show."""

import re
from functools import partial
from pathlib import Path

from lfpipe.config import Render
from lfpipe.config.modes import CameraViewer, MouseViewer, NoViewer, Window
from lfpipe.config.modes import Viewer as ViewerKind
from lfpipe.config.quality import level_number
from lfpipe.notices import latency_lines, notices
from lfpipe.render.synthesis.viewpoint import zero_plane_px
from lfpipe.render.ui.files import Files
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.scene.inverted_depth import remember, undecided
from lfpipe.scene.lightfield import HARDLY_FIT
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.status import State, rate_hz

COMMAND = re.compile(r"`|--|lfpipe |\b[a-z]+\.[a-z_]+=|/")  # of a terminal
SHOWN_NS = 2 * SECOND_NS  # reading a line takes 1 s
ASKED_NS = 8 * SECOND_NS  # how long the question about depth stays
DRAG = "put on the glasses, and drag over the picture to look around"
INVITATION = "put on the glasses and stand in front of the screen"
ROWS_UNKNOWN = "Wayland hides the position of this window: press f, or the eyes may be swapped"
GLASSES = {  # value of render.anaglyph -> its glasses
    "dubois": "red/cyan glasses",
    "colour": "red/cyan glasses, full colours",
    "half-colour": "red/cyan glasses, half the colours",
    "grey": "red/cyan glasses, grey",
    "wimmer": "red/cyan glasses, muted reds",
    "dubois-green-magenta": "green/magenta glasses",
    "dubois-amber-blue": "amber/blue glasses",
    "mono": "no glasses",
    "side-by-side": "a 3D television, side by side",
    "row-interleaved": "a 3D screen, row by row",
}


VIEWERS = {"camera": "My camera", "mouse": "Mouse", "demo": "Recorded face"}


def viewer_kind(viewer: ViewerKind) -> str:
    """A key of VIEWERS, or "" for nobody."""
    match viewer:
        case MouseViewer():
            return "mouse"
        case CameraViewer(source=source) if not source.startswith("demo"):
            return "camera"
        case NoViewer():
            return ""
    return "demo"


def viewer_name(viewer: ViewerKind) -> str:
    """Who looks, for people; "" for nobody."""
    return VIEWERS.get(viewer_kind(viewer), "")


class Notices:
    """Notices for a time, by subject: a new one replaces the previous one of its subject."""

    def __init__(self) -> None:
        self._passing: dict[str, tuple[str, int]] = {}  # subject -> (text, end)

    def show(self, subject: str, text: str, shown_ns: int = SHOWN_NS) -> None:
        """Shows text for shown_ns."""
        self._passing.pop(subject, None)  # the newest comes last
        self._passing[subject] = text, now_ns() + shown_ns

    @property
    def newest(self) -> tuple[str, int] | None:
        """The last one that was shown, and its end."""
        return next(reversed(self._passing.values()), None)

    def lines(self, t_ns: int, standing: list[str]) -> tuple[str, ...]:
        """The lines to show at t_ns. standing: those that stay while they are true."""
        passing = [text for text, end_ns in self._passing.values() if end_ns > t_ns]
        return tuple(dict.fromkeys(filter(None, (*passing, *standing))))


def for_window(error: str, remedy: str) -> str:
    """An error and its remedy in the window: without paths and commands of a terminal."""
    text, *_ = error.replace(str(Path.home()), "~").splitlines()
    if text.startswith(("/", "~")):
        path, _, text = text.partition(": ")
        text = f"{Path(path).name}: {text}"
    else:
        text = f"{text[:1].upper()}{text[1:]}"
    return f"{text}." if COMMAND.search(remedy) else f"{text}: {remedy}.".replace(": .", ".")


def status_lines(context: Context, viewer: Viewer) -> tuple[str, ...]:
    """The current state of the session, for the overlay; `lfpipe monitor` has more."""
    own, source = (context.table.rows[name] for name in (context.spec.name, context.spec.source))
    field = viewer.field
    render = context.config.render
    views = viewer.last_viewpoints
    alpha = f"alpha {viewer.parallax.alpha_px:.1f} px/view" if viewer.parallax else "no face yet"
    has_camera = source["state"] != State.NONE
    camera = f"camera {rate_hz(source):5.1f} Hz" if has_camera else "no camera"
    lines = [
        f"{camera}   pictures {rate_hz(own):5.1f} Hz",
        *latency_lines(
            summary_ms(own["age"]),
            summary_ms(context.row.histograms["prediction"].record),
            bool(context.row["planned"]),
        ),
        (
            f"{viewer.method}, {render.anaglyph}, {alpha}, zero plane"
            f" {zero_plane_px(field, render):+.2f} px/view"
        ),
    ]
    if views:
        lines.append(
            f"row {views.left[0]:.1f}, columns {views.left[1]:.1f} and {views.right[1]:.1f} of"
            f" {field.rows}x{field.cols} views"
        )
    return tuple(lines)


def changes(before: Render, now: Render, alpha_px: float, plane_px: float) -> dict[str, str]:
    """A notice for each changed setting that is visible, by its key.

    alpha_px, plane_px: the previous values, for a setting that was "auto".
    """
    words = {
        "depth": f"depth: {now.depth:.0%} of the way from comfort to true",
        "anaglyph": f"colours for {GLASSES[now.anaglyph]}",
        "zero_plane_px": "depth: the scene moves "
        + _direction(now.zero_plane_px, plane_px, "back", "forward"),
        "alpha_px": f"parallax: {_direction(now.alpha_px, alpha_px, 'more', 'less')}",
        "method": f"views: {now.method}",
        "swap_eyes": f"eyes: {'swapped' if now.swap_eyes else 'not swapped'}",
        "ghost_compensation": f"ghost compensation: {now.ghost_compensation:.0f} %",
    }
    return {
        name: text for name, text in words.items() if getattr(before, name) != getattr(now, name)
    }


def _direction(value: float | str, before: float, up: str, down: str) -> str:
    if isinstance(value, str):
        return "automatically"
    return up if value > before else down


class ChangeNotices:
    """Shows a notice for each change of settings, scene and quality, from any client."""

    def __init__(self, context: Context, viewer: Viewer, shown: Notices, files: Files) -> None:
        self._context = context
        self._files = files
        self._viewer = viewer
        self._shown = shown
        self._render = context.config.render
        self._level = level_number(context.options)
        self._scene = viewer.field.name
        self._inverted = viewer.field.depth_inverted
        self._alpha_px = 0.0  # before the latest change

    def update(self) -> bool:
        """Shows changes since the last call; returns whether the scene changed."""
        field = self._viewer.field
        render, before = self._context.config.render, self._render
        if render is not before:
            texts = changes(before, render, self._alpha_px, zero_plane_px(field, before))
            for subject, text in texts.items():
                self._shown.show(subject, text)
            self._render = render
        if self._viewer.parallax is not None:
            self._alpha_px = self._viewer.parallax.alpha_px
        level = level_number(self._context.options)
        if level and not self._level:
            self._shown.show("quality", "CPU overloaded: picture quality reduced")
        self._level = level
        is_new = field.name != self._scene
        if is_new:
            self._shown.show("scene", field.name)
            self.show_doubts()
        elif field.depth_inverted != self._inverted:
            self._shown.show("depth order", "depth is inverted: press d to undo")
        self._scene, self._inverted = field.name, field.depth_inverted
        return is_new

    def show_doubts(self) -> None:
        """Shows that the views of a scene hardly fit together; and how to invert depth, the first
        time that a scene of undecided depth is shown.
        """
        options = self._context.options
        field = self._viewer.field
        on_screen = isinstance(options.display, Window) and not options.lock_code
        if on_screen and HARDLY_FIT in field.manifest.notes:
            self._shown.show("views", HARDLY_FIT, ASKED_NS)
        if on_screen and undecided(field, self._context.config.scene.invert_depth):
            self._shown.show("depth order", "press d if the depth looks inverted", ASKED_NS)
            self._files.do(partial(remember, field, "asked"))


def standing_notices(context: Context, knows_rows: bool) -> list[str]:
    """The notices that stay while their condition lasts. knows_rows: of the display."""
    lines = []
    if context.config.render.anaglyph == "row-interleaved" and not knows_rows:
        lines.append(ROWS_UNKNOWN)
    is_locked = bool(context.options.lock_code)
    if context.paused:
        lines.append("paused" if is_locked else "paused: press p or space to resume")
    t_face_ns = context.row["t_face_ns"]
    rows, source = context.table.rows, context.spec.source
    frames = context.table.metrics[source].read(rows[source])
    current = notices(rows, source, context.spec.name, t_face_ns, frames)
    if current and is_locked:  # notices are for the operator
        is_alone = any(notice.nobody for notice in current)
        return [*lines, INVITATION if is_alone else DRAG]
    return [*lines, *(notice.text for notice in current)]
