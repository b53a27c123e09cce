"""Motion to photon of a running session, by the definitions of docs/photon.md.

Onset: from the moment at which a resting head has moved by ONSET of the distance between its eyes
to the light of the first picture made for eyes that have moved as far. It contains everything on
the way: the wait for a frame, the filter's own lag, the prediction, the loop's delay. Steady: how
far pictures lag behind a head that has been under way for SETTLED_NS: the eyes at the time of the
light, compared with the eyes that the picture was made for. The start of a motion is no part of it.
"""

import math
from collections import deque
from typing import NamedTuple

from lfpipe.eyes import MAX_STEP_NS, Eyes, middle_of
from lfpipe.render.presenter import REPLACED, Listener, Presentation
from lfpipe.transport.ring import MS_NS, SECOND_NS
from lfpipe.transport.status import Row

# of the eye distance: ten times the noise, while the head has hardly moved; 3 px in docs/photon.md
ONSET = 0.05
REST_NS = 400 * MS_NS  # at least this long within half of ONSET: a rest
# from the rest to ONSET at most: a slower motion has no clear beginning
START_NS = 200 * MS_NS
WITHIN_NS = 600 * MS_NS  # a later picture is unrelated to the motion
UNDER_WAY = 0.5  # eye distances per second; below, noise dominates
# the slowest filter (mean of 5 at 30 Hz: 167 ms) and a loop of 130 ms have settled
SETTLED_NS = 300 * MS_NS
DECAY = 0.995  # decay of the sums per picture: some 200 pictures in motion
SHARE = 0.2  # weight of the newest onset in its running mean, which begins as a plain mean


class _Frame(NamedTuple):
    """Eyes of a camera frame."""

    t_ns: int
    at: complex
    """The middle of the eyes, px: x + iy."""
    eye_distance_px: float


class _Picture(NamedTuple):
    """A picture, on the camera's clock."""

    t_light_ns: int
    """When it appears."""
    t_middle_ns: int
    """The middle of its display time, for which it was made."""
    at: complex
    """The middle of the eyes that it was made for."""


class MotionLatency(Listener):
    """Measures the latency of a session whose device latency is known, for the status row."""

    def __init__(self, row: Row) -> None:
        self._row = row
        self._frames: deque[_Frame] = deque()  # of the last REST_NS
        self._pictures: deque[_Picture] = deque(maxlen=240)  # a second and more at every rate
        self._rest: _Frame | None = None  # the middle of the last rest, and its end
        # when the last one began, from where; its reach, px
        self._motion: tuple[_Frame, float] | None = None
        self._under_way_ns: int | None = None  # since then
        self._onsets = 0
        self._lag = self._power = 0.0

    def add_eyes(self, t_sensor_ns: int, eyes_px: Eyes | None) -> None:
        """Adds the measured eyes of a frame; None without a face.

        A frame that was added before counts once.
        """
        last = self._frames[-1] if self._frames else None
        if eyes_px is None or (last is not None and not 0 <= t_sensor_ns - last.t_ns < MAX_STEP_NS):
            self._frames.clear()
            self._rest = self._motion = self._under_way_ns = last = None
        if eyes_px is None or (last is not None and t_sensor_ns == last.t_ns):
            return
        frame = _Frame(
            t_sensor_ns, complex(*middle_of(eyes_px)), max(math.dist(eyes_px[:2], eyes_px[2:]), 1.0)
        )
        if last is not None:
            self._add_lag(last, frame)
            self._find_motion(last, frame)
        if self._motion is not None and t_sensor_ns > self._motion[0].t_ns + WITHIN_NS:
            self._add_onset()
        self._frames.append(frame)
        while len(self._frames) > 2 and self._frames[1].t_ns <= t_sensor_ns - REST_NS:
            self._frames.popleft()

    def add_picture(
        self, t_presented_ns: int, after_ns: int, device_latency_ns: int, eyes_px: Eyes
    ) -> None:
        """Adds a presented picture, made for eyes_px at after_ns later; device_latency_ns: the
        delay of camera and display in that.
        """
        self._pictures.append(
            _Picture(
                t_presented_ns + device_latency_ns,
                t_presented_ns + after_ns,
                complex(*middle_of(eyes_px)),
            )
        )

    def _add_lag(self, last: _Frame, frame: _Frame) -> None:
        """Compares the pictures between two frames with where the eyes were."""
        period_ns = frame.t_ns - last.t_ns
        step = frame.at - last.at
        if abs(step) / last.eye_distance_px * SECOND_NS / period_ns < UNDER_WAY:
            self._under_way_ns = None
            return
        if self._under_way_ns is None:
            self._under_way_ns = last.t_ns
        for picture in self._pictures:
            share = (picture.t_middle_ns - last.t_ns) / period_ns
            if not 0 < share <= 1 or picture.t_middle_ns - self._under_way_ns < SETTLED_NS:
                continue
            behind = (last.at + share * step - picture.at) * step.conjugate()
            self._lag = DECAY * self._lag + behind.real * period_ns
            self._power = DECAY * self._power + abs(step) ** 2
            self._row["steady_ns"] = round(self._lag / self._power)

    def _find_motion(self, last: _Frame, frame: _Frame) -> None:
        """Finds the end of a rest: the time at which the eyes were ONSET from where they had
        rested.
        """
        reach_px = ONSET * last.eye_distance_px
        frames = self._frames
        if frames[0].t_ns <= last.t_ns - 0.9 * REST_NS:
            mean = sum(f.at for f in frames) / len(frames)
            if max(abs(f.at - mean) for f in frames) < reach_px / 2:
                self._rest = last._replace(at=mean)
        if (rest := self._rest) is None:
            return
        before_px, now_px = abs(last.at - rest.at), abs(frame.at - rest.at)
        if now_px <= reach_px:
            if frame.t_ns - rest.t_ns > START_NS:
                self._rest = None
            return
        t_ns = last.t_ns + round(
            (reach_px - before_px) / (now_px - before_px) * (frame.t_ns - last.t_ns)
        )
        self._add_onset()
        self._motion, self._rest = (rest._replace(t_ns=t_ns), reach_px), None

    def _add_onset(self) -> None:
        """Finds the first picture that shows the last motion, if it is not found yet."""
        if self._motion is None:
            return
        (start, reach_px), self._motion = self._motion, None
        shows = [
            picture.t_light_ns - start.t_ns
            for picture in self._pictures
            if abs(picture.at - start.at) > reach_px
        ]
        if late_ns := [late_ns for late_ns in shows if 0 <= late_ns <= WITHIN_NS]:
            self._onsets += 1
            change_ns = late_ns[0] - self._row["onset_ns"]
            self._row["onset_ns"] += round(change_ns * max(SHARE, 1 / self._onsets))

    def handed_over(self, presentation: Presentation) -> None:
        eyes = presentation.eyes
        if presentation.display_time.device_latency_ns and eyes is not None and not eyes.by_mouse:
            self.add_eyes(eyes.t_ns, eyes.record.raw_px if presentation.face else None)

    def presented(self, presentation: Presentation) -> None:
        display_time = presentation.display_time
        if (
            not (display_time.device_latency_ns and presentation.composed and presentation.face)
            or presentation.by == REPLACED
        ):
            return
        after_ns = display_time.seen_ns - (presentation.due_ns or presentation.t_handed_ns)
        self.add_picture(
            presentation.t_presented_ns,
            after_ns,
            display_time.device_latency_ns,
            presentation.viewpoints.eyes_px,
        )
