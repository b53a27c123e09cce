"""How far velocity and acceleration of the head carry, as measured so far.

At constant acceleration a, the mean velocity over the next h seconds is v + a h / 2. Reaches and swaying follow that. A nod
turns within a tenth of a second: there an acceleration carries too far, and over a long delay of camera and display a velocity
does, too. So the shares of both that are used are measured over the delay that predictions cover: least-squares factors, of
velocity between where the head went and where the velocity pointed, of acceleration between what that missed and what
acceleration would have added.
"""

import math
from collections import deque

FRAME_S = 0.07  # horizon without a loop: age of the frame, a camera period, half a refresh; the best of 0.05 to 0.1 on real heads
SMOOTH_S = 0.03  # of the acceleration: about one frame of a webcam
MEMORY_S = 10.0
MOST_GAINED = 2.0  # by one line, times what it adds; more is a glitch of the landmarks
# Squared distances between the eyes that a line of velocity or of acceleration adds at most; landmarks that jump add more.
MOST_MOVED, MOST_BENT = 1.0, 0.1
# The same as evidence: less than this leaves velocity at its full share, and acceleration near 0.
UNPROVEN, NOTHING = 0.3, 0.01

Pair = tuple[float, float]


class Extrapolation:
    """Corrects velocities by what has improved predictions. All in px; a new run of the filter needs a new one.

    loop_s: delay of camera and display.
    """

    def __init__(self, loop_s: float) -> None:
        self._horizon_ns = round((FRAME_S + loop_s) * 1e9)
        self._velocity = self._acceleration = (0.0, 0.0)
        self._lines: deque[tuple[int, Pair, Pair, Pair]] = deque()  # stamp, position, velocity, acceleration
        self._moved = self._pointed = UNPROVEN
        self._gained = self._bent = 0.0

    def corrected(self, t_ns: int, dt_s: float, position: Pair, velocity: Pair, measured: Pair, apart_px: float) -> Pair:
        """The velocity to predict with from t_ns on.

        position, velocity: estimates at t_ns, px and px/s. measured: the eyes' midpoint at t_ns, px. dt_s: since the last one.
        """
        share = dt_s / (dt_s + SMOOTH_S)
        (ax, ay), (ux, uy) = self._acceleration, self._velocity
        ax += share * ((velocity[0] - ux) / dt_s - ax)
        ay += share * ((velocity[1] - uy) / dt_s - ay)
        keep = math.exp(-dt_s / MEMORY_S)
        self._moved, self._pointed = UNPROVEN + keep * (self._moved - UNPROVEN), UNPROVEN + keep * (self._pointed - UNPROVEN)
        self._gained, self._bent = keep * self._gained, keep * self._bent
        while self._lines and t_ns - self._lines[0][0] > self._horizon_ns:
            self._score(t_ns, measured, apart_px * apart_px)
        self._velocity, self._acceleration = velocity, (ax, ay)
        self._lines.append((t_ns, position, velocity, (ax, ay)))
        speed = self._share()
        ahead_s = self._horizon_ns / 2e9 * min(max(self._gained / (self._bent + NOTHING), 0.0), 1.0)
        return speed * velocity[0] + ahead_s * ax, speed * velocity[1] + ahead_s * ay

    def _share(self) -> float:
        return min(max(self._moved / self._pointed, 0.0), 1.0)

    def _score(self, t_ns: int, measured: Pair, unit: float) -> None:
        """Compares the oldest line with the measurement that it predicted. unit: squared px of one distance between the eyes."""
        began_ns, (x, y), (u, v), (ax, ay) = self._lines.popleft()
        ahead_s, share = (t_ns - began_ns) / 1e9, self._share()
        dx, dy, px, py = measured[0] - x, measured[1] - y, u * ahead_s, v * ahead_s
        pointed, moved = (px * px + py * py) / unit, (dx * px + dy * py) / unit
        weight = 1 / (1 + pointed / MOST_MOVED) ** 2
        self._pointed += weight * pointed
        self._moved += weight * min(max(moved, -MOST_GAINED * pointed), MOST_GAINED * pointed)
        bend = ahead_s * ahead_s / 2
        dx, dy, px, py = dx - share * px, dy - share * py, ax * bend, ay * bend
        bent, gained = (px * px + py * py) / unit, (dx * px + dy * py) / unit
        weight = 1 / (1 + bent / MOST_BENT) ** 2
        self._bent += weight * bent
        self._gained += weight * min(max(gained, -MOST_GAINED * bent), MOST_GAINED * bent)
