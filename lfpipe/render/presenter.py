"""Chooses what a refresh shows, composes changes only, and notifies listeners. A `Presentation` is
what a refresh shows; between submission and vblank they wait, and are reported in order.

`choose` reads no clock and needs no process: the caller gives every time, so that a simulation runs
the same choices as the render stage. For each refresh:

    source.update(EyesRecord.of(buffer), stamp)      # for a newer record
    display_time = DisplayTime(target_ns, refresh_ns, device_latency_ns)
    eyes = source.at(t_ns, mouse)                    # t_ns: now, when the picture is begun
    viewpoints, wanted = choose(viewer, eyes, display_time)
    if wanted != key:                                # else the picture on the screen is current
        picture = viewer.compositor.draw(wanted)

What does not change the next picture happens after submission, in the listeners.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.eyes import MAX_STEP_NS, EyesRecord
from lfpipe.host.presentation import Presented
from lfpipe.render.display.display import Display
from lfpipe.render.display.refresh import COST_SHARE, Refresh, ScreenRefresh
from lfpipe.render.synthesis.anaglyph import Pair
from lfpipe.render.synthesis.compositor import Key
from lfpipe.render.viewer.mouse_look import MouseLook
from lfpipe.render.viewer.viewer import VIDEO_LEAD, Viewer, Viewpoints
from lfpipe.transport.ring import MS_NS, Stamp, now_ns, sleep_until

# A record is stale, because the tracker died or hangs, if it is older than MAX_STEP_NS and than
# STALE_FRAMES frame intervals.
STALE_FRAMES = 3


@attrs.frozen
class DisplayTime:
    """When a picture is shown and seen, in monotonic ns."""

    target_ns: int
    """The refresh that the picture is due at; without refreshes, the expected submission."""
    refresh_ns: int = 0
    """How long it stays on the screen; 0: until the next camera frame."""
    device_latency_ns: int = 0
    """Delay of camera and display together, not included in stamps and target_ns."""
    on_vblanks: bool = False
    """Whether target_ns is a vblank that the window system reports."""

    @property
    def seen_ns(self) -> int:
        """The time that the picture is made for: the middle of its refresh, which minimizes the
        error over it, plus the latency.
        """
        return self.target_ns + self.device_latency_ns + self.refresh_ns // 2


class TrackedEyes(NamedTuple):
    """The eyes that a picture is made for."""

    record: EyesRecord
    stamp: Stamp
    """Of their frame."""
    t_ns: int
    """The time that the eye positions refer to, where prediction starts: the frame's, or that of
    the choice for the mouse and for nobody."""
    waited_ns: int = 0
    """From their publication until they were read."""
    by_mouse: bool = False


@attrs.define(eq=False)
class EyesSource:
    """Chooses the eyes for a picture: the newest record, the mouse, or nobody if the newest record
    is stale.
    """

    _lossless: bool = False
    """Frames wait for pictures, so no record is ever stale."""
    newest: TrackedEyes | None = None
    """The eyes of the newest record; None: of another viewer, or of none yet."""
    _stale_ns: int = MAX_STEP_NS

    def update(self, record: EyesRecord, stamp: Stamp, t_ns: int = 0) -> None:
        """Takes a newer record of the tracker, read at t_ns."""
        old = self.newest
        if old is not None and stamp.epoch == old.stamp.epoch:
            interval_ns = stamp.t_sensor_ns - old.stamp.t_sensor_ns
            self._stale_ns = max(MAX_STEP_NS, STALE_FRAMES * interval_ns)
        self.newest = TrackedEyes(
            record, stamp, stamp.t_sensor_ns, waited_ns=max(t_ns - stamp.t_publish_ns, 0)
        )

    def at(self, t_ns: int, mouse: MouseLook | None = None) -> TrackedEyes | None:
        """The eyes for a picture that is begun at t_ns; None before the first record."""
        newest = self.newest
        if mouse is not None and mouse.is_viewer:
            record, stamp = mouse.eyes(newest and newest.record, newest and newest.stamp, t_ns)
            return TrackedEyes(
                record, stamp, t_ns, newest.waited_ns if newest else 0, by_mouse=True
            )
        if newest is None or self._lossless or t_ns - newest.t_ns <= self._stale_ns:
            return newest
        # the tracker died or hangs
        return newest._replace(record=newest.record._replace(face=0), t_ns=t_ns)


def choose(
    viewer: Viewer, eyes: TrackedEyes | None, display_time: DisplayTime
) -> tuple[Viewpoints, Key]:
    """The viewpoints for eyes at a display time, which must not decrease from call to call, and the
    key by which a compositor draws their picture.
    """
    lead_ns = round(VIDEO_LEAD * display_time.refresh_ns) if display_time.on_vblanks else 0
    record, t_ns = (None, display_time.seen_ns) if eyes is None else (eyes.record, eyes.t_ns)
    viewpoints = viewer.viewpoints(record, t_ns, display_time.seen_ns, lead_ns)
    return viewpoints, viewer.compositor.key(*viewpoints[1:])


ANSWER_NS = 250 * MS_NS  # a hidden window gets no report
HANDOVER, REPLACED = "handover", "replaced"


@attrs.define(kw_only=True)
class Presentation:
    """What one refresh, or one camera frame, showed."""

    seq: int
    """Counts presentations, over all restarts of the stage."""
    number: int
    """Number of the picture, from 1; 0: no new picture."""
    display_time: DisplayTime
    eyes: TrackedEyes | None
    """The eyes it was made for; None: no record yet."""
    viewpoints: Viewpoints
    picture: NDArray[np.uint8] | None
    """The picture on the screen, uint8 (height, width, 3) BGR; valid until the next one."""
    t_started_ns: int
    t_composed_ns: int
    t_handed_ns: int
    cost_ns: int
    """Time of composing and submission; 0: no new picture."""
    t_presented_ns: int = 0
    """0: never seen, or not known yet."""
    by: str = ""
    """The protocol that reported t_presented_ns, HANDOVER or REPLACED; empty: not known yet."""
    juddered: bool = False
    """Whether it was shown at another vblank than planned."""
    more: dict[str, Any] = attrs.field(factory=dict)
    """Fields that a listener adds to its line of the trace."""

    @property
    def composed(self) -> bool:
        """Whether it was a new picture."""
        return self.number > 0

    @property
    def face(self) -> bool:
        """Whether it was made for a face."""
        return self.eyes is not None and bool(self.eyes.record.face)

    @property
    def due_ns(self) -> int:
        """The refresh that it was made for; 0 for none."""
        return self.display_time.target_ns if self.display_time.refresh_ns else 0


class Listener:
    """Reacts to presentations; a listener defines only the methods that it needs."""

    def set_options(self, options: SessionOptions) -> None:
        """Sets the session's options: called before the first presentation and when they change."""

    def handed_over(self, presentation: Presentation) -> None:
        """Receives a presentation that was submitted to the display."""

    def presented(self, presentation: Presentation) -> None:
        """Receives a presentation whose display time is known; each is submitted first."""

    def close(self) -> None:
        """Closes its outputs."""


def pop_timed(
    waiting: deque[Presentation], answers: Iterable[Presented], by: str, t_ns: int
) -> list[Presentation]:
    """Removes the presentations, in order, whose display time is certain at t_ns: their vblank, 0
    if the next picture replaced them before it, or their submission without a report within
    ANSWER_NS. by: the protocol that reports; already set if a refresh repeated the picture on the
    screen.
    """
    unanswered = {
        presentation.number: presentation
        for presentation in waiting
        if presentation.composed and not presentation.by
    }
    for answer in answers:
        if (presentation := unanswered.get(answer.serial)) is not None:
            presentation.t_presented_ns = answer.t_ns
            presentation.by = by if answer.t_ns else REPLACED
    timed = []
    while waiting and (waiting[0].by or t_ns - waiting[0].t_handed_ns > ANSWER_NS):
        timed.append(presentation := waiting.popleft())
        if not presentation.by:
            presentation.t_presented_ns = presentation.t_handed_ns
            presentation.by = HANDOVER
    return timed


class Drawing(NamedTuple):
    """A picture and its views."""

    picture: NDArray[np.uint8]
    """uint8 (height, width, 3) BGR, valid until the next one."""
    pair: Pair | None
    """The left and the right view that it consists of, for a screen that must arrange them."""


Draw = Callable[[Viewer, Key], Drawing]


def draw_scene(viewer: Viewer, key: Key) -> Drawing:
    """The picture of the viewer's scene."""
    return Drawing(viewer.compositor.draw(key), viewer.compositor.pair)


@attrs.define(eq=False, kw_only=True)
class Presenter:
    """One display's pictures."""

    _viewer: Viewer
    _source: EyesSource
    _mouse: MouseLook
    """The viewer if there is no camera or its right button is held."""
    _display: Display
    _refresh: Refresh | None
    """The display's clock, None with one picture per camera frame."""
    _listeners: Sequence[Listener] = ()
    _seq: int = 0
    """Of the next presentation."""
    _draw: Draw = draw_scene
    _key: Key | None = None
    _number: int = 0
    _waiting: deque[Presentation] = attrs.field(factory=deque)  # between submission and vblank
    cost_ns: int = 0
    """Running mean of composing and showing a picture."""
    picture: NDArray[np.uint8] | None = None
    """The last picture on the screen."""
    changed_ns: int = 0
    """When a picture was last composed, or asked for."""

    def saved_picture(self) -> NDArray[np.uint8] | None:
        """The last picture, for a file: the scene's at its own size. None before the first one."""
        is_scene = self.picture is not None and self._draw is draw_scene
        return self._viewer.full_picture() if is_scene else self.picture

    def redraw(self) -> None:
        """Composes the next picture even if its key is unchanged."""
        self._key = None
        self.changed_ns = now_ns()

    def draw_by(self, draw: Draw) -> None:
        """Sets the function that draws the following pictures."""
        self._draw = draw
        self.redraw()

    def show(self, display_time: DisplayTime) -> None:
        """Shows the picture for a display time; without refreshes, always a new one."""
        if self._viewer.update_compositor():
            self.redraw()
        t_started_ns = now_ns()
        eyes = self._source.at(t_started_ns, self._mouse)
        viewpoints, key = choose(self._viewer, eyes, display_time)
        drawing = None
        if key != self._key or not display_time.refresh_ns:
            self._key = key
            self.changed_ns = t_started_ns
            drawing = self._draw(self._viewer, key)
            self.picture = drawing.picture
            self._number += 1
        t_composed_ns = now_ns()
        if self._refresh is not None:
            sleep_until(self._refresh.earliest_ns(display_time.target_ns))
        t_handed_ns, cost_ns = now_ns(), 0
        if drawing is not None:
            t_handing_ns, cpu_ns = t_handed_ns, time.process_time_ns()
            t_handed_ns = self._display.show(*drawing, self._viewer.config.render.anaglyph)
            handing_ns = t_handed_ns - t_handing_ns
            if display_time.on_vblanks:  # a swap may wait for the screen, which is not work
                handing_ns = min(handing_ns, time.process_time_ns() - cpu_ns)
            cost_ns = t_composed_ns - t_started_ns + handing_ns
        presentation = Presentation(
            seq=self._seq,
            number=self._number if drawing is not None else 0,
            display_time=display_time,
            eyes=eyes,
            viewpoints=viewpoints,
            picture=self.picture,
            t_started_ns=t_started_ns,
            t_composed_ns=t_composed_ns,
            t_handed_ns=t_handed_ns,
            cost_ns=cost_ns,
        )
        self._seq += 1
        if presentation.composed:
            self.cost_ns += int(COST_SHARE * (cost_ns - self.cost_ns))
            if self._refresh is not None:
                self._refresh.add_cost(cost_ns)
        for listener in self._listeners:
            listener.handed_over(presentation)
        if not self._display.vblank_source:
            presentation.t_presented_ns = presentation.t_handed_ns
            self._report(presentation)
            return
        if not presentation.composed:
            presentation.t_presented_ns = presentation.due_ns or presentation.t_handed_ns
            presentation.by = self._display.vblank_source
        self._waiting.append(presentation)

    def _report(self, presentation: Presentation) -> None:
        """Notifies the listeners of a presentation whose display time is certain."""
        planned = (
            presentation.composed and presentation.due_ns and presentation.by not in ("", HANDOVER)
        )
        if planned and isinstance(self._refresh, ScreenRefresh):
            presentation.juddered = self._refresh.judge(
                presentation.due_ns, presentation.t_handed_ns, presentation.t_presented_ns
            )
        for listener in self._listeners:
            listener.presented(presentation)

    def report(self, waits: bool = True) -> None:
        """Processes the window system's reports of pictures and vblanks. waits: for later ones of
        pictures that were just submitted.
        """
        answers = self._display.presented() if waits else []
        if isinstance(self._refresh, ScreenRefresh):
            self._refresh.vblanks(answers)
        t_ns = now_ns() + 2 * ANSWER_NS * (not waits)
        for one in pop_timed(self._waiting, answers, self._display.vblank_source, t_ns):
            self._report(one)

    def close(self) -> None:
        """Flushes pending presentation reports and closes the listeners."""
        self.report(waits=False)
        for listener in self._listeners:
            listener.close()
