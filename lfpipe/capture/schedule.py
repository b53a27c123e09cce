"""Due times of a recording's frames: absolute deadlines in whole nanoseconds, so that errors never add up."""

from fractions import Fraction

# A container that counts milliseconds rounds each stamp by up to 0.5 ms, the encoder by as much again.
# Within that, the even grid of the frame rate is more accurate than the stamps.
STAMP_ROUNDING_NS = 1_000_000
MOVE_NS = 1_000_000_000


class EvenSchedule:
    """Frame k is due k periods after frame 0, by integer arithmetic: the error stays below 1 ns."""

    def __init__(self, rate_hz: float) -> None:
        period = 1_000_000_000 / Fraction(rate_hz).limit_denominator(1001)  # 29.97002997 stands for 30000/1001
        self._period_ns, self._parts = period.numerator, period.denominator

    def due_ns(self, index: int) -> int:
        """Nanoseconds from frame 0 to frame index."""
        return index * self._period_ns // self._parts


class StampSchedule:
    """Due times by the recording's own stamps. Unless they are exact, they snap to the even grid of its rate where they agree.

    A stamp that does not increase counts as one period after the frame before, so due times always grow.
    """

    def __init__(self, rate_hz: float, exact: bool = False) -> None:
        self._even, self._rounding_ns = EvenSchedule(rate_hz), 0 if exact else STAMP_ROUNDING_NS
        self._step_ns = max(1, self._even.due_ns(1))
        self._base_ns = 0  # due time of the first frame of this loop
        self._count = 0
        self._first_stamp_ns = 0
        self._last_ns = -1

    def due_ns(self, stamp_ns: int) -> int:
        """Nanoseconds from the very first frame to the next one, stamped stamp_ns in the file."""
        if self._count == 0:
            self._first_stamp_ns = stamp_ns
        even_ns = self._base_ns + self._even.due_ns(self._count)
        due_ns = self._base_ns + stamp_ns - self._first_stamp_ns
        if abs(due_ns - even_ns) <= self._rounding_ns:
            due_ns = even_ns
        if due_ns <= self._last_ns:
            due_ns = self._last_ns + self._step_ns
        self._last_ns = due_ns
        self._count += 1
        return due_ns

    def restart(self) -> None:
        """Starts the next loop: the first frame is due one period after the last."""
        self._base_ns = self._last_ns + self._step_ns
        self._count = 0


class Lateness:
    """Drops or reschedules late frames of a recording. late_ns: tolerance, 0 for none.

    After a hiccup frames are dropped, as a camera's driver would overwrite them, until playback has caught up. If it does not,
    because decoding takes longer than a period, or if playback stood still for MOVE_NS, the schedule moves: dropping on would
    leave no frame at all.
    """

    def __init__(self, late_ns: int) -> None:
        self._late_ns, self._behind_ns = late_ns, 0
        self.moved_ns = 0  # delay of playback against the original schedule

    def drops(self, due_ns: int, t_read_ns: int) -> bool:
        """Whether to drop the frame due at due_ns that was read at t_read_ns; may move the schedule."""
        late_ns = t_read_ns - due_ns - self.moved_ns
        if not self._late_ns or late_ns <= self._late_ns:
            self._behind_ns = 0
            return False
        if late_ns > MOVE_NS or 0 < self._behind_ns <= late_ns:
            self.moved_ns += late_ns
            self._behind_ns = 0
            return False
        self._behind_ns = late_ns
        return True
