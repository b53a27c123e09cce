"""When pictures are due: an even rate whose phase follows the camera, or the vblanks that
the window system reports.
"""

import math

from lfpipe.eyes import MAX_STEP_NS
from lfpipe.host.presentation import Presented
from lfpipe.transport.ring import MS_NS, SECOND_NS

SLACK = 0.2  # of a period, at most 3 ms: tolerated lateness of eyes
# of each frame in phase and period: 20 frames, over which jitter of stamps averages out
GAIN = 0.05
NEAR_RATIO = 0.01  # tolerance of the ratio of both rates to a whole number
COST_SHARE = 0.1  # weight of the newest in the running mean of a picture's cost
SPARE_NS = MS_NS  # additional lead of composing


class Refresh:
    """The display's clock at rate_hz, first due at t0_ns; its phase follows the camera's frames."""

    def __init__(self, rate_hz: float, t0_ns: int) -> None:
        self._due_ns = float(t0_ns)
        self._period_ns = 1e9 / rate_hz
        self._cost_ns = 0
        self._camera_period_ns = 0.0
        self._last: tuple[int, int] | None = None  # (source_seq, t_sensor_ns) of the previous eyes
        self._locked = False  # whether the phase is the camera's

    @property
    def period_ns(self) -> int:
        """Time from one picture to the next."""
        return int(self._period_ns)

    def due_ns(self) -> int:
        """When the next picture is due on the screen."""
        return int(self._due_ns)

    def lead_ns(self) -> int:
        """The time before its due time at which a picture must be begun."""
        return self._cost_ns + SPARE_NS

    def start_ns(self) -> int:
        """When the next picture must be begun."""
        return self.due_ns() - self.lead_ns()

    def earliest_ns(self, target_ns: int) -> int:
        """The earliest submission of a picture for target_ns."""
        return target_ns

    def add_cost(self, cost_ns: int) -> None:
        """Adds what a picture cost."""
        share = COST_SHARE if self._cost_ns else 1.0
        self._cost_ns += int(share * (cost_ns - self._cost_ns))

    def limit(self, rate_hz: float | str, nominal_hz: float) -> None:
        """Takes `render.rate_hz` now in force; nominal_hz: the rate if it is "auto"."""
        if 1e9 / nominal_hz != self._period_ns:
            self._period_ns = 1e9 / nominal_hz
            self._locked = False

    def advance(self, t_ns: int) -> int:
        """Advances to the next refresh after t_ns; returns how many were missed."""
        missed = int(max((t_ns - self._due_ns) // self._period_ns, 0))
        self._due_ns += (1 + missed) * self._period_ns
        return missed

    def add_eyes(self, source_seq: int, t_sensor_ns: int, t_eyes_ns: int) -> None:
        """Records that new eyes, of that frame, arrived at t_eyes_ns."""
        last, self._last = self._last, (source_seq, t_sensor_ns)
        if last is None or source_seq <= last[0] or t_sensor_ns - last[1] > MAX_STEP_NS:
            self._locked = False  # the first frame, or the first after a gap: the phase is new
            return
        period_ns = (t_sensor_ns - last[1]) / (source_seq - last[0])
        self._camera_period_ns += (period_ns - self._camera_period_ns) * (
            GAIN if self._camera_period_ns else 1.0
        )
        ratio = self._camera_period_ns / self._period_ns
        if round(ratio) < 1 or abs(ratio - round(ratio)) > NEAR_RATIO * ratio:
            return
        slack_ns = min(SLACK * self._period_ns, 3 * MS_NS)
        half_ns = self._period_ns / 2
        late_ns = t_eyes_ns + slack_ns + self.lead_ns() - self.due_ns()
        late_ns = (late_ns + half_ns) % self._period_ns - half_ns
        self._due_ns += GAIN * late_ns if self._locked else late_ns  # first, nothing is visible yet
        self._locked = True


# phase within a few vblanks; period over a hundred: some servers report whole ms
PHASE_GAIN, PERIOD_GAIN = 0.3, 0.01
OFF_GRID = 0.35  # of a period: a vblank further off belongs to another grid
OFF_COUNT = 5  # after this many such vblanks in a row the clock follows the other grid
# of a period: beyond it from the reported one, the window is on another screen
PERIOD_RANGE = 0.12
# The lead is the mean cost of a picture and a margin, which holds the rest: how much costs vary,
# how late the process wakes up, how long before a vblank the window system takes a picture.
# The first late picture for a while widens the margin by the least step, for a machine that stands
# still now and then is late with any margin; the next ones by twice as much. No picture is sent
# earlier than that after the vblank before its own.
STEP_NS = MS_NS // 2
SOON = 20  # pictures
# A screen may show the oldest of several pictures in flight. After a late one, each then takes the
# vblank of the next, for good: after so many in a row, as many vblanks as they are late get no
# picture. If that does not help, the compositor takes pictures ahead.
# Punctual pictures narrow the margin, by the cube of their number since the last late one: by the
# least step in 500, so that 1 picture in 500 is late, and by 8 ms in 1000.
NARROWING = 4 * STEP_NS / 500**4
MAX_COST_PERIODS = 4.0  # of a picture: slower ones say nothing about the next
# The margin's limit where it requires none: no picture may be submitted earlier, so more margin
# covers only late wake-ups. At 144 Hz, without this limit, every second vblank gets no picture.
MAX_MARGIN_PERIODS = 1.25


class ScreenClock:
    """The grid of vblanks: its period and phase. nominal_hz: its rate until one is reported."""

    def __init__(self, nominal_hz: float, t0_ns: int) -> None:
        self.period_ns = 1e9 / nominal_hz
        self._t_ns = float(t0_ns)
        self._off = OFF_COUNT

    def vblank(self, t_ns: int, period_ns: int = 0) -> None:
        """Adds a vblank at t_ns. period_ns: reported with it, or 0."""
        if abs(period_ns / self.period_ns - 1) > PERIOD_RANGE and period_ns > MS_NS:
            # another monitor, or one that claims another rate
            self.period_ns, self._off = float(period_ns), OFF_COUNT
        count = round((t_ns - self._t_ns) / self.period_ns)
        error_ns = t_ns - self._t_ns - count * self.period_ns
        self._off = self._off + 1 if abs(error_ns) > OFF_GRID * self.period_ns else 0
        if self._off >= OFF_COUNT:
            self._t_ns, self._off = float(t_ns), 0
        elif count > 0 and not self._off:
            self._t_ns += count * self.period_ns + PHASE_GAIN * error_ns
            self.period_ns += PERIOD_GAIN * error_ns / count

    def nearest(self, t_ns: float) -> int:
        """The vblank nearest to t_ns."""
        return round(self._t_ns + round((t_ns - self._t_ns) / self.period_ns) * self.period_ns)


class ScreenRefresh(Refresh):
    """Refreshes on the vblanks that a screen reports, at nominal_hz until its first report.

    Pictures are due at vblanks, whose phase does not follow the camera, and begin a lead before
    them that is learnt from late and early pictures. limit_hz: at most this many pictures a second,
    0 for every vblank.
    """

    def __init__(self, nominal_hz: float, t0_ns: int, limit_hz: float = 0.0) -> None:
        super().__init__(nominal_hz, t0_ns)
        self.clock = ScreenClock(nominal_hz, t0_ns)
        self._limit_hz = limit_hz
        self._last_cost_ns = 0
        self._punctual = 0  # pictures since the last late one
        self._margin_ns = 4.0 * MS_NS  # most window systems need less
        # by how much more than a period before its vblank a picture may be submitted
        self._ahead_ns = 0.0
        self._changed_ns = 0  # when a late or early picture changed the margin
        self._queued = 0  # pictures in a row that waited for an earlier one
        self._margin_before_ns = self._margin_ns  # the first of them

    @property
    def period_ns(self) -> int:
        limit_ns = SECOND_NS / self._limit_hz if self._limit_hz else 0.0
        return round(max(1, round(limit_ns / self.clock.period_ns)) * self.clock.period_ns)

    def due_ns(self) -> int:
        return self.clock.nearest(self._due_ns)

    def lead_ns(self) -> int:
        return int(self._cost_ns + self._margin_ns)

    def earliest_ns(self, target_ns: int) -> int:
        """Before it, the picture would appear at the previous vblank."""
        return int(target_ns - self.clock.period_ns + STEP_NS - self._ahead_ns)

    def add_eyes(self, source_seq: int, t_sensor_ns: int, t_eyes_ns: int) -> None:
        pass

    def add_cost(self, cost_ns: int) -> None:
        """A picture may cost several periods, and is then begun as long before its vblank. A single
        one of more than a period is a stall: it counts as the one before.
        """
        period_ns, before_ns = self.clock.period_ns, self._last_cost_ns
        self._last_cost_ns = cost_ns
        counted_ns = min(cost_ns, before_ns) if cost_ns > period_ns else cost_ns
        super().add_cost(min(counted_ns, round(MAX_COST_PERIODS * period_ns)))

    def judge(self, target_ns: int, t_handed_ns: int, t_presented_ns: int) -> bool:
        """Learns from a picture for the vblank target_ns, shown at t_presented_ns, 0 for never;
        returns whether that was not its vblank.

        Late: the lead was too short. A whole period early: too long. A picture begun before the
        margin changed is no evidence about the new margin, and one that its own process submitted
        a period too late was stalled. A late one that was submitted more than a period before it
        was shown waited for another, which no margin changes. One that was replaced is late by a
        vblank.
        """
        period_ns = self.clock.period_ns
        t_presented_ns = t_presented_ns or round(target_ns + period_ns)
        vblanks = round((t_presented_ns - target_ns) / period_ns)
        if vblanks <= 0 or t_presented_ns - t_handed_ns <= period_ns:
            self._queued, self._margin_before_ns = 0, self._margin_ns
        self._queued += vblanks > 0
        if self._queued == SOON:
            self._due_ns += round(vblanks * period_ns)
            self._margin_ns = self._margin_before_ns + 2 * STEP_NS
            self._changed_ns = t_presented_ns
        if t_handed_ns <= self._changed_ns or t_handed_ns >= target_ns + period_ns:
            return vblanks != 0
        self._punctual += 1
        if vblanks < 0:
            self._margin_ns -= 2 * STEP_NS
            self._ahead_ns = max(self._ahead_ns - 2 * STEP_NS, 0.0)
        elif vblanks:
            step_ns = STEP_NS * (1 + (self._punctual <= SOON))
            if t_handed_ns <= self.earliest_ns(target_ns) + STEP_NS:
                # even the earliest submission was late: the compositor takes pictures ahead
                self._ahead_ns = min(self._ahead_ns + step_ns, MAX_MARGIN_PERIODS * period_ns)
            self._margin_ns += step_ns * max(1.0, self._cost_ns / period_ns)
        else:
            self._margin_ns -= NARROWING * self._punctual**3
        if vblanks:
            self._changed_ns, self._punctual = max(t_presented_ns, t_handed_ns), 0
        most_ns = MAX_MARGIN_PERIODS * max(period_ns, self._cost_ns) + self._ahead_ns
        self._margin_ns = min(max(self._margin_ns, STEP_NS), most_ns)
        return vblanks != 0

    def vblanks(self, reports: list[Presented]) -> None:
        """Takes the window system's reports."""
        for report in reports:
            if report.t_ns:
                self.clock.vblank(report.t_ns, report.period_ns)

    def limit(self, rate_hz: float | str, nominal_hz: float) -> None:
        self._limit_hz = 0.0 if rate_hz == "auto" else nominal_hz

    def advance(self, t_ns: int) -> int:
        """Advances to the next vblank whose picture can still be begun in time at t_ns."""
        period_ns = self.period_ns
        self._due_ns = self.due_ns() + period_ns
        late_ns = t_ns - (self._due_ns - self.lead_ns())
        # a late wake-up is tolerated, but nothing where the pictures alone take the period
        slack_ns = max(min(self.lead_ns(), period_ns - self._cost_ns), 0) / 2
        passed = math.ceil((late_ns - slack_ns) / period_ns) if late_ns > slack_ns else 0
        self._due_ns += passed * period_ns
        return passed
