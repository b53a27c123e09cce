"""Due times of pictures on a display that accepts one at any time: an even rate whose phase follows the camera.

If the display's rate is a multiple of the camera's, a picture composed right after new eyes arrive shows them up to one refresh
sooner than one composed just before. The phase therefore creeps there, in steps too small to see.
"""

from lfpipe.transport.clock import MS_NS, SECOND_NS, Ticker

SLACK = 0.2  # of a period, at most 3 ms: tolerated lateness of eyes
GAIN = 0.05
LARGEST_STEP = 0.01  # of a period
LONGEST_NS = SECOND_NS // 2  # from frame to frame; after a longer gap the camera or the machine stood still
NEAR_RATIO = 0.01  # tolerance of the ratio of both rates to a whole number


class Refresh:
    """The display's clock, rate_hz, first due at t0_ns."""

    def __init__(self, rate_hz: float, t0_ns: int) -> None:
        self.rate_hz = rate_hz
        self._ticker = Ticker(rate_hz, t0_ns)
        self._period_ns = 1e9 / rate_hz
        self._camera_period_ns = 0.0
        self._locked = False
        self._last: tuple[int, int] | None = None  # (source_seq, t_sensor_ns) of the previous eyes

    @property
    def period_ns(self) -> int:
        return int(self._period_ns)

    @property
    def missed(self) -> int:
        """Refreshes that passed while a picture was being made."""
        return self._ticker.missed

    def due_ns(self) -> int:
        """When the next picture is due on the screen."""
        return self._ticker.due_ns()

    def advance(self, t_ns: int) -> None:
        """Advances to the next refresh after t_ns."""
        self._ticker.advance(t_ns)

    def heard(self, source_seq: int, t_sensor_ns: int, t_eyes_ns: int, lead_ns: int) -> None:
        """Records that new eyes, of that frame, arrived at t_eyes_ns; a picture takes lead_ns from its start to the screen."""
        last, self._last = self._last, (source_seq, t_sensor_ns)
        if last is None or source_seq <= last[0] or t_sensor_ns - last[1] > LONGEST_NS:
            self._locked = False  # the first frame, or the first after a gap: the phase is new
            return
        period_ns = (t_sensor_ns - last[1]) / (source_seq - last[0])
        self._camera_period_ns += (period_ns - self._camera_period_ns) * (GAIN if self._camera_period_ns else 1.0)
        ratio = self._camera_period_ns / self._period_ns
        if round(ratio) < 1 or abs(ratio - round(ratio)) > NEAR_RATIO * ratio:
            return
        slack_ns = min(SLACK * self._period_ns, 3 * MS_NS)
        late_ns = (t_eyes_ns + slack_ns + lead_ns - self.due_ns()) % self._period_ns
        if late_ns > self._period_ns / 2:
            late_ns -= self._period_ns
        if not self._locked:  # nothing is visible yet: shift at once
            self._locked = True
            self._ticker.shift(int(late_ns))
            return
        largest_ns = LARGEST_STEP * self._period_ns
        self._ticker.shift(int(min(max(GAIN * late_ns, -largest_ns), largest_ns)))
