"""Notices over the picture, the lines of key o, and what a person changes in the window: settings,
which the supervisor applies and the window stores, and recordings; and the thread for a person's
files.
"""

import contextlib
import os
import re
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial, reduce
from pathlib import Path
from typing import Any, TypeVar

import attrs
import platformdirs

from lfpipe.config import Render, user_file
from lfpipe.config.check import changed, write_keys
from lfpipe.config.quality import level_number
from lfpipe.config.session_options import CameraViewer, MouseViewer, NoViewer, Window
from lfpipe.config.session_options import Viewer as ViewerKind
from lfpipe.errors import UserError
from lfpipe.host.files import exists
from lfpipe.notices import notices
from lfpipe.render.display.display import VIEWERS, Event, Item, Notice
from lfpipe.render.synthesis.viewpoint import zero_plane_px, zero_planes_px
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.scene.lightfield import HARDLY_FIT, remember, undecided
from lfpipe.sequence.folder import MANIFEST
from lfpipe.transport.context import Context
from lfpipe.transport.ring import SECOND_NS, now_ns
from lfpipe.transport.status import State, rate_hz, summary_ms

COMMAND = re.compile(r"`|--|lfpipe |\b[a-z]+\.[a-z_]+=|/")  # of a terminal
LONG_MS, CAMERA_HZ = 150.0, 30.0  # full bars
SHOWN_NS = 2 * SECOND_NS  # reading a line takes 1 s
QUESTION_NS = 8 * SECOND_NS  # how long a question, a path and a hint stay
DRAG = "Put on the glasses, and drag over the picture to look around"
INVITATION = "Put on the glasses and stand in front of the screen"
USE_CAMERA = Item("Use my camera", Event("look", "camera"), main=True)
USE_MOUSE = Item("Use the mouse", Event("look", "mouse"))
RECORDED_FACE = Notice(
    "A recorded face moves this picture.",
    (
        USE_CAMERA,
        USE_MOUSE,
        Item("×", Event("dismiss")),
    ),
)
ROWS_UNKNOWN = Notice(
    "The eyes may be swapped in a window.", (Item("Full screen", Event("fullscreen")),)
)
PAUSED = "Paused: p or Space resumes"
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


def sentence(text: str) -> str:
    """Text that begins with a capital letter."""
    return text[:1].upper() + text[1:]


def short(path: Path) -> str:
    """A path for people."""
    return str(path).replace(str(Path.home()), "~")


@attrs.define(eq=False)
class Notices:
    """Notices for a time, by subject: a new one replaces the previous one of its subject."""

    _passing: dict[str, tuple[Notice, int]] = attrs.field(factory=dict)  # subject -> (notice, end)

    def show(
        self, subject: str, text: str, shown_ns: int = SHOWN_NS, items: tuple[Item, ...] = ()
    ) -> None:
        """Shows text, and what can be done about it, for shown_ns."""
        self._passing.pop(subject, None)  # the newest comes last
        self._passing[subject] = Notice(text, items), now_ns() + shown_ns

    @property
    def newest(self) -> Notice | None:
        """The last one that was shown."""
        return next((notice for notice, _ in reversed(self._passing.values())), None)

    def current(self, t_ns: int, standing: Iterable[Notice]) -> tuple[Notice, ...]:
        """The notices at t_ns. standing: those that stay while they are true."""
        passing = [notice for notice, end_ns in self._passing.values() if end_ns > t_ns]
        return tuple(dict.fromkeys(notice for notice in (*passing, *standing) if notice.text))


def for_window(error: str, remedy: str = "") -> str:
    """An error and its remedy in the window: without paths and commands of a terminal."""
    text, *_ = error.splitlines()
    path, _, reason = text.partition(": ")
    text = f"{Path(path).name}: {reason}" if text.startswith("/") else sentence(text)
    return f"{text}." if not remedy or COMMAND.search(remedy) else f"{text}: {remedy}."


def metrics(context: Context, viewer: Viewer) -> tuple[str, ...]:
    """The current state of the session, for the overlay; `lfpipe monitor` has more."""
    own, source = (context.table.rows[name] for name in (context.spec.name, context.spec.source))
    config, field, views = context.config, viewer.field, viewer.last_viewpoints
    age = summary_ms(own["age"])
    ahead = summary_ms(context.row.histograms["prediction"].record)
    rates = [("Pictures", rate_hz(own), config.render.nominal_hz)]
    if source["state"] != State.NONE:
        rates.append(("Camera", rate_hz(source), CAMERA_HZ))
    times = [
        ("Camera to screen", age["p50_ms"], age["n"]),
        ("Worst 5 %", age["p95_ms"], age["n"]),
        ("Predicted ahead", ahead["p50_ms"], ahead["n"]),
    ]
    lines = ["Rate", *(f"{name}\t{hz:.0f} Hz\t{hz / full}" for name, hz, full in rates)]
    lines += ["", "Latency"] * any(count for *_, count in times)
    lines += [f"{name}\t{ms:.0f} ms\t{ms / LONG_MS}" for name, ms, count in times if count]
    if views:
        columns = ("Left eye", views.left[1]), ("Right eye", views.right[1])
        last = max(1, field.cols - 1)
        lines += ["", f"Column of {field.cols}"]
        lines += [f"{name}\t{col + 1:.1f}\t{col / last}" for name, col in columns]
    return tuple(lines)


def standing_notices(context: Context, knows_rows: bool) -> Iterator[Notice]:
    """The notices that stay while their condition lasts. knows_rows: of the display."""
    is_locked = bool(context.options.lock_code)
    if context.config.render.anaglyph == "row-interleaved" and not knows_rows and not is_locked:
        yield ROWS_UNKNOWN
    if context.paused:
        yield Notice("Paused" if is_locked else PAUSED)
    t_face_ns = context.row["t_face_ns"]
    rows, source = context.table.rows, context.spec.source
    frames = context.table.metrics[source].read(rows[source])
    current = notices(rows, source, context.spec.name, t_face_ns, frames)
    if current and is_locked:  # notices are for the operator
        yield Notice(INVITATION if any(notice.nobody for notice in current) else DRAG)
    else:
        yield from (Notice(sentence(notice.text)) for notice in current)


T = TypeVar("T")


@attrs.define(eq=False)
class Files:
    """A thread that reads and writes a person's files in order: a disk may be slow, or a network
    drive dead. It ends with the stage, once everything is saved.
    """

    _context: Context
    _thread: ThreadPoolExecutor = attrs.field(factory=lambda: ThreadPoolExecutor(1, "files"))
    _waiting: deque[tuple[Future[Any], Callable[[Any], None]]] = attrs.field(factory=deque)

    def do(self, work: Callable[[], T], done: Callable[[T], None] = lambda _: None) -> None:
        """Does work in the thread; `serve` then passes its result to done."""
        self._waiting.append((self._thread.submit(work), done))

    def serve(self) -> Iterator[UserError]:
        """Passes on the results; yields the errors."""
        while self._waiting and self._waiting[0][0].done():
            future, done = self._waiting.popleft()
            try:
                done(future.result())
            except UserError as error:
                yield error

    def close(self) -> None:
        """Waits until everything is saved."""
        with self._context.saving("saving your settings"):
            self._thread.shutdown()


INVERTED = Item("Swap near and far", Event("invert-depth"), "d")
STORED = {"anaglyph": "Glasses", "swap_eyes": "Eyes", "ghost_compensation": "Ghosts"}  # in a notice


@attrs.define(eq=False)
class Settings:
    """Requests changes of [render], and shows a notice for each change of settings, scene and
    quality, from any client.
    """

    _context: Context
    _viewer: Viewer
    _notices: Notices
    _files: Files
    requested: list[dict[str, Any]] = attrs.field(factory=list)
    """Changes of keys that are neither applied nor refused yet, in the order of their answers."""
    _alpha_px: float = 0.0  # before the latest change
    _last: tuple[Render, int, str, bool] = attrs.field(
        init=False, default=attrs.Factory(lambda self: self._now(), takes_self=True)
    )

    @property
    def render(self) -> Render:
        """The settings as they will be: keys may follow each other faster than they are applied."""
        return reduce(changed, self.requested, self._context.config).render

    def set(self, **values: Any) -> None:
        """Changes keys of [render] until the session ends."""
        self.request({f"render.{key}": value for key, value in values.items()})

    def request(self, keys: dict[str, Any]) -> None:
        """Changes keys until the session ends."""
        self.requested.append(keys)
        self._context.request("set", set=keys)

    def store(self, values: dict[str, float | bool | str]) -> None:
        """Saves keys of [render] in the person's settings."""
        names = ", ".join(STORED.get(name, name) for name in values)
        self._files.do(
            partial(write_keys, user_file(), "render", values),
            lambda _: self._notices.show("stored", f"{names} saved"),
        )

    def move_zero_plane(self, steps: int) -> None:
        """Moves the scene back (steps > 0) or forward."""
        field = self._viewer.field
        *_, step_px = zero_planes_px(field.disparity_min_px, field.disparity_max_px)
        number = round(zero_plane_px(field, self.render) / step_px) + steps
        self.set(zero_plane_px=round(number * step_px, 6))

    def scale_alpha(self, factor: float) -> None:
        """Multiplies alpha."""
        if self._viewer.parallax is not None:
            self.set(alpha_px=round(self._viewer.parallax.alpha_px * factor, 3))

    def _now(self) -> tuple[Render, int, str, bool]:
        """The settings, the lowered level, the scene and its order of depth."""
        context, field = self._context, self._viewer.field
        return (
            context.config.render,
            level_number(context.options),
            field.name,
            field.depth_inverted,
        )

    def show_changes(self) -> bool:
        """Shows changes since the last call; returns whether the scene changed."""
        (render, level, scene, inverted), self._last = self._last, self._now()
        now, now_level, now_scene, now_inverted = self._last
        if now is not render:
            plane_px = zero_plane_px(self._viewer.field, render)
            for subject, text in changes(render, now, self._alpha_px, plane_px).items():
                self._notices.show(subject, text)
        if self._viewer.parallax is not None:
            self._alpha_px = self._viewer.parallax.alpha_px
        if now_level and not level:
            self._notices.show("quality", "Busy computer: picture quality reduced")
        if now_scene != scene:
            self._notices.show("scene", now_scene)
            self.show_doubts()
        elif now_inverted != inverted:
            self._notices.show("depth order", "Near and far swapped")
        return now_scene != scene

    def show_doubts(self) -> None:
        """Shows that the views of a scene hardly fit together; and how to invert depth, the first
        time that a scene of undecided depth is shown.
        """
        options, field = self._context.options, self._viewer.field
        if not isinstance(options.display, Window) or options.lock_code:
            return
        if HARDLY_FIT in field.manifest.notes:
            text = f"These {field.rows * field.cols} pictures hardly fit together."
            way_out = (Item("Show one", Event("show-one", field.manifest.source)),)
            self._notices.show("views", text, QUESTION_NS, way_out)
        if undecided(field, self._context.config.scene.invert_depth):
            self._notices.show(
                "depth order", "Does the depth look inverted?", QUESTION_NS, (INVERTED,)
            )
            self._files.do(partial(remember, field, "asked"))


def changes(before: Render, now: Render, alpha_px: float, plane_px: float) -> dict[str, str]:
    """A notice for each changed setting that is visible, by its key.

    alpha_px, plane_px: the previous values, for a setting that was "auto".
    """
    words = {
        "depth": f"Depth {now.depth:.0%}: 0 % is comfortable, 100 % true",
        "anaglyph": f"For {GLASSES[now.anaglyph]}" if now.anaglyph != "mono" else "No glasses",
        "zero_plane_px": "Scene "
        + _direction(now.zero_plane_px, plane_px, "further back", "further forward"),
        "alpha_px": f"Parallax: {_direction(now.alpha_px, alpha_px, 'more', 'less')}",
        "method": f"Views: {now.method}",
        "swap_eyes": "Eyes swapped" if now.swap_eyes else "Eyes not swapped",
        "ghost_compensation": f"Ghosts {now.ghost_compensation:.0f} %",
    }
    return {
        name: text for name, text in words.items() if getattr(before, name) != getattr(now, name)
    }


def _direction(value: float | str, before: float, up: str, down: str) -> str:
    if isinstance(value, str):
        return "automatic"
    return up if value > before else down


FLUSH_NS = 10 * SECOND_NS  # a slow disk may take as long to take the rest


@attrs.define(eq=False)
class RecordingIndicator:
    """Starts and stops recordings, and shows the duration of any client's recording."""

    _context: Context
    _notices: Notices
    _folder: str = ""
    _began_ns: int = 0
    is_requested: bool = False
    """Whether a start or a stop is not answered yet."""
    # the last one, its length, and until when it may still be written
    _ended: tuple[Path, int, int] | None = None
    status: str = ""
    """Time of the current recording; "" for none."""

    def toggle(self) -> None:
        """Starts recording the camera and the eyes in the folder for pictures, or stops it."""
        if self.is_requested:
            return
        path = ""
        if not self._context.options.record:
            path = str(
                user_folder(platformdirs.user_videos_path())
                / time.strftime("lfpipe-recording-%Y%m%d-%H%M%S")
            )
            if self._context.paused:
                self._context.request("resume")
            self._notices.show("record", "Starting the recording ...", FLUSH_NS)
        self.is_requested = True
        self._context.request("record", path=path)

    def update(self, t_ns: int) -> None:
        """Updates the status."""
        folder = self._context.options.record
        duration_s = (t_ns - self._began_ns) // SECOND_NS
        if folder != self._folder:
            if self._folder:
                self._ended = Path(self._folder), duration_s, t_ns + FLUSH_NS
            else:
                self._notices.show("record", "Recording")
            self._folder, self._began_ns, duration_s = folder, t_ns, 0
        if self._ended is not None:
            path, length_s, until_ns = self._ended
            text = "Nothing recorded: stopped before the first frame"
            if exists(path / MANIFEST):
                text, until_ns = f"Camera recorded, {length_s} s: {short(path)}", 0
            if t_ns >= until_ns:
                self._ended = None
                self._notices.show("record", text, QUESTION_NS)
        self.status = f"{duration_s // 60}:{duration_s % 60:02}" * bool(folder)


def user_folder(folder: Path) -> Path:
    """A folder of the desktop's, as ~/Pictures, which is made if it is missing; the working
    directory if the desktop has none.
    """
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        if folder != Path.home() and os.access(folder, os.W_OK):
            return folder
    return Path.cwd()
