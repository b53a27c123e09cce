"""Due times of a recording's frames: absolute deadlines in whole nanoseconds, so that errors never
add up.
"""

from fractions import Fraction

# A container that counts milliseconds rounds each stamp by up to 0.5 ms, the encoder by as much
# again. Within that, the even grid of the frame rate is more accurate than the stamps.
STAMP_ROUNDING_NS = 1_000_000
MOVE_NS = 1_000_000_000  # longer than any hiccup of a busy machine


class Schedule:
    """Due times of a recording that may be played in rounds.

    Frame k of a round is due k periods after its first, by integer arithmetic: the error stays
    below 1 ns. rounding_ns: stamps that differ by more from this even grid are due by their stamps;
    None: the frames have no stamps. Due times always grow: a stamp that does not increase counts as
    one period after the frame before.
    """

    def __init__(self, rate_hz: float, rounding_ns: int | None = None) -> None:
        # 29.97002997 means 30000/1001
        period = 1_000_000_000 / Fraction(rate_hz).limit_denominator(1001)
        self._period_ns = period.numerator
        self._parts = period.denominator
        self._step_ns = max(1, self._period_ns // self._parts)
        self._rounding_ns = rounding_ns
        # due time and stamp of the first frame of this round
        self._round_ns = self._first_stamp_ns = 0
        self._index = self._last_ns = -1

    def due_ns(self, index: int, stamp_ns: int = 0) -> int:
        """Nanoseconds from the very first frame to the next one, number index of its round. A
        number that does not rise begins a round, one period after the last frame.
        """
        if index <= self._index or self._last_ns < 0:
            self._round_ns = self._last_ns + self._step_ns if self._last_ns >= 0 else 0
            self._first_stamp_ns = stamp_ns
        self._index = index
        due_ns = self._round_ns + index * self._period_ns // self._parts
        stamped_ns = self._round_ns + stamp_ns - self._first_stamp_ns
        if self._rounding_ns is not None and abs(stamped_ns - due_ns) > self._rounding_ns:
            due_ns = stamped_ns
        if due_ns <= self._last_ns:
            due_ns = self._last_ns + self._step_ns
        self._last_ns = due_ns
        return due_ns


class Lateness:
    """Drops or reschedules late frames of a recording. late_ns: tolerance, 0 for none.

    After a hiccup frames are dropped, as a camera's driver would overwrite them, until playback has
    caught up. If it does not, because decoding takes longer than a period, or if playback stood
    still for MOVE_NS, catching up is impossible: the schedule is shifted instead of dropping every
    frame.
    """

    def __init__(self, late_ns: int) -> None:
        self._late_ns = late_ns
        self._behind_ns = 0
        self.moved_ns = 0  # delay of playback against the original schedule

    def drops(self, due_ns: int, t_read_ns: int) -> bool:
        """Whether to drop the frame due at due_ns that was read at t_read_ns; may move the
        schedule.
        """
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
