"""Motion to photon of a running session, by the definitions of docs/photon.md.

Onset: the time from an unforeseeable motion to its light: half a frame's period to the exposure, then from the sensor's stamp to
the first picture of that frame, then the loop's delay. Steady: how far pictures lag behind a moving head, with prediction: the
eyes at the time of the light, compared with the eyes that the picture was made for.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from lfpipe.transport.clock import SECOND_NS

SHARE = 0.05  # weight of the newest onset in its running mean, which begins as a plain mean
KEPT = 0.995  # decay of the sums per picture: some 200 pictures in motion
UNDER_WAY = 0.5  # distances between the eyes per second; slower, noise is most of it
MOST_PICTURES = 120  # waiting for the frame that shows where the eyes were
GAP_NS = SECOND_NS // 4  # from frame to frame; after a longer gap the time between is unknown

Points = NDArray[np.float64]


class MotionLatency:
    """onset_ns, steady_ns: 0 until known."""

    def __init__(self) -> None:
        self.onset_ns = self.steady_ns = 0
        self._pictures: deque[tuple[int, Points]] = deque(maxlen=MOST_PICTURES)
        self._last: tuple[int, Points] | None = None
        self._period_ns = 0
        self._shown_ns = self._onsets = 0  # stamp of the frame whose first picture was shown; how many such
        self._lag = self._power = 0.0

    def measured(self, t_sensor_ns: int, eyes_px: Points | None) -> None:
        """Adds a frame's measured eyes, (2, 2) px; None without a face."""
        last, self._last = self._last, None if eyes_px is None else (t_sensor_ns, eyes_px.copy())
        if last is None or self._last is None or not 0 < t_sensor_ns - last[0] < GAP_NS:
            self._pictures.clear()
            return
        self._period_ns = t_sensor_ns - last[0]
        moved_px = self._last[1] - last[1]
        apart_px = max(float(np.hypot(*(last[1][0] - last[1][1]))), 1.0)
        speed = float(np.sqrt(np.square(moved_px).sum() / 2)) / apart_px * SECOND_NS / self._period_ns
        while self._pictures and self._pictures[0][0] <= t_sensor_ns:
            seen_ns, used_px = self._pictures.popleft()
            share = (seen_ns - last[0]) / self._period_ns
            if share < 0 or speed < UNDER_WAY:
                continue
            behind_px = last[1] + share * moved_px - used_px
            self._lag = KEPT * self._lag + float((behind_px * moved_px).sum()) * self._period_ns
            self._power = KEPT * self._power + float(np.square(moved_px).sum())
            self.steady_ns = round(self._lag / self._power)

    def pictured(self, t_sensor_ns: int, t_presented_ns: int, after_ns: int, loop_ns: int, eyes_px: Points) -> None:
        """Adds a presented picture, made for eyes_px, (2, 2) px, from the frame of t_sensor_ns. after_ns: from t_sensor_ns to the
        time that it was made for; loop_ns: the part of it that is the delay of camera and display.
        """
        self._pictures.append((t_presented_ns + after_ns, eyes_px.copy()))
        if t_sensor_ns != self._shown_ns and self._period_ns:  # not known of the first frame, which waits for the start, too
            self._shown_ns = t_sensor_ns
            self._onsets += 1
            onset_ns = self._period_ns // 2 + t_presented_ns - t_sensor_ns + loop_ns
            self.onset_ns += round((onset_ns - self.onset_ns) * max(SHARE, 1 / self._onsets))
