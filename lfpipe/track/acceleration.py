"""The acceleration of the head, as far as it has improved predictions so far.

At constant acceleration a, the mean velocity over the next h seconds is v + a h / 2. Reaches and swaying follow that, and a
straight line falls behind them. A nod turns within a tenth of a second, and an acceleration carries too far. So the share of it
that is used is measured: the least-squares factor between what straight lines of HORIZON_S missed and what acceleration would
have added.
"""

import math
from collections import deque

HORIZON_S = 0.1  # of a picture: age of its frame, refresh, camera and display
SMOOTH_S = 0.03  # of the acceleration: about one frame of a webcam
MEMORY_S = 10.0
MOST_GAINED = 2.0  # by one line, times what acceleration adds to it; more is a glitch of the landmarks
MOST_BENT = 0.1  # squared distances between the eyes (60 of them per s^2): no head does more for long, landmarks that jump do
NOTHING = 0.01  # squared distances between the eyes: less evidence than this leaves the share near 0

Pair = tuple[float, float]


class Acceleration:
    """Corrects velocities for the acceleration that is observed. All in px; a new run of the filter needs a new one."""

    def __init__(self) -> None:
        self._velocity = self._acceleration = (0.0, 0.0)
        self._lines: deque[tuple[int, Pair, Pair, Pair]] = deque()  # stamp, position, velocity, acceleration
        self._gained = self._possible = 0.0

    def corrected(self, t_ns: int, dt_s: float, position: Pair, velocity: Pair, measured: Pair, apart_px: float) -> Pair:
        """The velocity to predict with from t_ns on.

        position, velocity: estimates at t_ns, px and px/s. measured: the eyes' midpoint at t_ns, px. dt_s: since the last one.
        """
        share = dt_s / (dt_s + SMOOTH_S)
        (ax, ay), (ux, uy) = self._acceleration, self._velocity
        ax += share * ((velocity[0] - ux) / dt_s - ax)
        ay += share * ((velocity[1] - uy) / dt_s - ay)
        keep = math.exp(-dt_s / MEMORY_S)
        self._gained, self._possible = keep * self._gained, keep * self._possible
        while self._lines and t_ns - self._lines[0][0] > HORIZON_S * 1e9:
            self._score(t_ns, measured, apart_px)
        self._velocity, self._acceleration = velocity, (ax, ay)
        self._lines.append((t_ns, position, velocity, (ax, ay)))
        ahead_s = HORIZON_S / 2 * min(max(self._gained / (self._possible + NOTHING), 0.0), 1.0)
        return velocity[0] + ahead_s * ax, velocity[1] + ahead_s * ay

    def _score(self, t_ns: int, measured: Pair, apart_px: float) -> None:
        """Compares the oldest straight line with the measurement that it predicted."""
        began_ns, (x, y), (u, v), (ax, ay) = self._lines.popleft()
        ahead_s = (t_ns - began_ns) / 1e9
        missed_x, missed_y = measured[0] - x - u * ahead_s, measured[1] - y - v * ahead_s
        added_x, added_y = ax * ahead_s * ahead_s / 2, ay * ahead_s * ahead_s / 2
        possible = (added_x * added_x + added_y * added_y) / apart_px**2
        gained = (missed_x * added_x + missed_y * added_y) / apart_px**2
        weight = 1 / (1 + possible / MOST_BENT) ** 2
        self._gained += weight * min(max(gained, -MOST_GAINED * possible), MOST_GAINED * possible)
        self._possible += weight * possible
