"""Notices over the picture, and the lines of key o: rates, latency, depth and the views on show."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from lfpipe.config.session_options import CameraViewer, MouseViewer, NoViewer
from lfpipe.config.session_options import Viewer as ViewerKind
from lfpipe.notices import notices
from lfpipe.render.display.display import Event, Item, Notice
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.context import Context
from lfpipe.transport.ring import SECOND_NS, now_ns
from lfpipe.transport.status import State, rate_hz, summary_ms

COMMAND = re.compile(r"`|--|lfpipe |\b[a-z]+\.[a-z_]+=|/")  # of a terminal
LONG_MS, CAMERA_HZ = 150.0, 30.0  # full bars
SHOWN_NS = 2 * SECOND_NS  # reading a line takes 1 s
ASKED_NS = 8 * SECOND_NS  # how long a question, a path and a hint stay
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
VIEWERS = {"camera": "Camera", "mouse": "Mouse", "demo": "Recorded face"}


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


class Notices:
    """Notices for a time, by subject: a new one replaces the previous one of its subject."""

    def __init__(self) -> None:
        self._passing: dict[str, tuple[Notice, int]] = {}  # subject -> (notice, end)

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
    if text.startswith("/"):
        path, _, text = text.partition(": ")
        text = f"{Path(path).name}: {text}"
    else:
        text = sentence(text)
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
        places = ("Left eye", views.left[1]), ("Right eye", views.right[1])
        last = max(1, field.cols - 1)
        lines += ["", f"Column of {field.cols}"]
        lines += [f"{name}\t{col + 1:.1f}\t{col / last}" for name, col in places]
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
