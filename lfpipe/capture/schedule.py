"""When the frames of a recording are due: absolute deadlines in whole nanoseconds, so that no error ever adds up."""

from __future__ import annotations

from fractions import Fraction

# A container that counts in milliseconds rounds every stamp by up to half of one; one more half for the encoder's own.
# Within that the even grid of the frame rate is nearer to the truth than the stamps.
STAMP_ROUNDING_NS = 1_000_000
MOVE_NS = 1_000_000_000


def period(rate_hz: float) -> Fraction:
    """Nanoseconds from frame to frame, exactly: 29.97002997 is taken for the 30000/1001 that it stands for."""
    return 1_000_000_000 / Fraction(rate_hz).limit_denominator(1001)


class EvenSchedule:
    """Frame k is due k periods after frame 0, by integer arithmetic: the error stays under 1 ns for ever."""

    def __init__(self, rate_hz: float) -> None:
        self._period = period(rate_hz)

    def due_ns(self, index: int) -> int:
        """Nanoseconds from frame 0 to frame index."""
        return index * self._period.numerator // self._period.denominator


class StampSchedule:
    """Frames are due as the recording's own stamps say, on the even grid of its rate where they agree with it.

    Stamps that go back or stand still count as one period after the frame before, so due times always grow.
    """

    def __init__(self, rate_hz: float) -> None:
        self._even = EvenSchedule(rate_hz)
        self._step_ns = max(1, self._even.due_ns(1))
        self._base_ns = 0  # due time of the first frame of this round through the file
        self._count = 0
        self._first_stamp_ns = 0
        self._last_ns = -1

    def due_ns(self, stamp_ns: int) -> int:
        """Nanoseconds from the very first frame to the next one, which the file stamps with stamp_ns."""
        if self._count == 0:
            self._first_stamp_ns = stamp_ns
        even_ns = self._base_ns + self._even.due_ns(self._count)
        due_ns = self._base_ns + stamp_ns - self._first_stamp_ns
        if abs(due_ns - even_ns) <= STAMP_ROUNDING_NS:
            due_ns = even_ns
        if due_ns <= self._last_ns:
            due_ns = self._last_ns + self._step_ns
        self._last_ns = due_ns
        self._count += 1
        return due_ns

    def restart(self) -> None:
        """The file starts over: its first frame is due one period after its last."""
        self._base_ns = self._last_ns + self._step_ns
        self._count = 0


class Lateness:
    """What becomes of a recording's frames that come late. late_ns: how late one may be, 0 for as late as it likes.

    After a hiccup frames are dropped, as a camera's driver would have overwritten them, until the recording has caught up. Where
    it does not, because decoding takes longer than a period, or where it has not been played for MOVE_NS, it goes on from where
    it stands: to drop on would leave no frame at all.
    """

    def __init__(self, late_ns: int) -> None:
        self._late_ns, self._behind_ns = late_ns, 0
        self.moved_ns = 0  # how much later than its own schedule the recording plays

    def drops(self, due_ns: int, t_read_ns: int) -> bool:
        """Whether the frame that was due at due_ns by its schedule, and came at t_read_ns, is dropped; may move the schedule."""
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
