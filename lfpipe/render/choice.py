"""Chooses what a refresh shows: the eyes, the display time and the picture.

Nothing here reads a clock or needs a process: the caller gives every time, so that a simulation
runs the same choices as the render stage. For each refresh:

    source.update(EyesRecord.of(buffer), stamp)      # for a newer record
    moment = Moment.of(target_ns, refresh_ns, device_latency_ns)
    eyes = source.at(t_ns, mouse)                    # t_ns: now, when the picture is begun
    choice = choose(viewer, eyes, moment)
    if choice.key != key:                            # else the picture on the screen is current
        picture = viewer.compositor.draw(choice.key)
"""

from typing import NamedTuple

import attrs

from lfpipe.eyes import MAX_STEP_NS, EyesRecord
from lfpipe.render.synthesis.compositor import Key
from lfpipe.render.viewer.mouse_look import MouseLook
from lfpipe.render.viewer.viewer import VIDEO_LEAD, Viewer, Viewpoints
from lfpipe.transport.ring import Stamp

# A record is stale, because the tracker died or hangs, if it is older than MAX_STEP_NS and than
# STALE_FRAMES frame intervals.
STALE_FRAMES = 3


@attrs.frozen(kw_only=True)
class DisplayTime:
    """When a picture is shown and seen, in monotonic ns."""

    target_ns: int
    """The refresh that the picture is due at; without refreshes, the expected submission."""
    refresh_ns: int
    """How long it stays on the screen; 0: until the next camera frame."""
    device_latency_ns: int
    """Delay of camera and display together, not included in stamps and target_ns."""
    seen_ns: int
    """The time that the picture is made for."""
    on_vblanks: bool
    """Whether target_ns is a vblank that the window system reports."""

    @classmethod
    def of(
        cls,
        target_ns: int,
        refresh_ns: int = 0,
        device_latency_ns: int = 0,
        on_vblanks: bool = False,
    ) -> "DisplayTime":
        """The display time of a picture that is due at target_ns: the middle of its refresh, which
        minimizes the error over it, plus the latency.
        """
        return cls(
            target_ns=target_ns,
            refresh_ns=refresh_ns,
            device_latency_ns=device_latency_ns,
            seen_ns=target_ns + device_latency_ns + refresh_ns // 2,
            on_vblanks=on_vblanks,
        )


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


class EyesSource:
    """Chooses the eyes for a picture: the newest record, the mouse, or nobody if the newest record
    is stale.
    """

    def __init__(self, lossless: bool = False) -> None:
        """lossless: frames wait for pictures, so no record is ever stale."""
        self._lossless = lossless
        self._newest: TrackedEyes | None = None
        self._stale_ns = MAX_STEP_NS

    def update(self, record: EyesRecord, stamp: Stamp, t_ns: int = 0) -> None:
        """Takes a newer record of the tracker, read at t_ns."""
        old = self._newest
        if old is not None and stamp.epoch == old.stamp.epoch:
            interval_ns = stamp.t_sensor_ns - old.stamp.t_sensor_ns
            self._stale_ns = max(MAX_STEP_NS, STALE_FRAMES * interval_ns)
        self._newest = TrackedEyes(
            record, stamp, stamp.t_sensor_ns, waited_ns=max(t_ns - stamp.t_publish_ns, 0)
        )

    @property
    def has_face(self) -> bool:
        """Whether the newest record is of a face."""
        return self._newest is not None and bool(self._newest.record.face)

    def forget(self) -> None:
        """Forgets the newest record: another viewer looks."""
        self._newest = None

    def at(self, t_ns: int, mouse: MouseLook | None = None) -> TrackedEyes | None:
        """The eyes for a picture that is begun at t_ns; None before the first record."""
        newest = self._newest
        if mouse is not None and mouse.is_viewer:
            record, stamp = mouse.eyes(newest and newest.record, newest and newest.stamp, t_ns)
            return TrackedEyes(
                record, stamp, t_ns, newest.waited_ns if newest else 0, by_mouse=True
            )
        if newest is None or self._lossless or t_ns - newest.t_ns <= self._stale_ns:
            return newest
        # the tracker died or hangs
        return newest._replace(record=newest.record._replace(face=0), t_ns=t_ns)


class Choice(NamedTuple):
    """The viewpoints of a picture, and the key by which a compositor draws it."""

    viewpoints: Viewpoints
    key: Key


def choose(viewer: Viewer, eyes: TrackedEyes | None, display_time: DisplayTime) -> Choice:
    """The picture for eyes at a display time, which must not decrease from call to call."""
    lead_ns = round(VIDEO_LEAD * display_time.refresh_ns) if display_time.on_vblanks else 0
    record, t_ns = (None, display_time.seen_ns) if eyes is None else (eyes.record, eyes.t_ns)
    viewpoints = viewer.viewpoints(record, t_ns, display_time.seen_ns, lead_ns)
    return Choice(viewpoints, viewer.compositor.key(*viewpoints[1:]))
