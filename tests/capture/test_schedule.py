"""Due times of recordings: exact, growing, faithful to the stamps."""

from fractions import Fraction
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.capture.recordings import STAMP_ROUNDING_NS, Lateness, Schedule

MS = 1_000_000


@given(
    st.fractions(min_value=Fraction(1, 10), max_value=1000, max_denominator=1001),
    st.integers(1, 10**9),
)
def test_even_frames_never_drift(rate: Fraction, index: int) -> None:
    exact = Fraction(10**9) * index / rate
    assert 0 <= exact - Schedule(float(rate)).due_ns(index) < 1
    assert Schedule(29.97002997002997).due_ns(30_000) == 1001 * 10**9, "30000/1001"


@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 24000 / 1001])
def test_rounded_stamps_give_the_even_grid_over_all_rounds(rate_hz: float) -> None:
    schedule, even = Schedule(rate_hz, STAMP_ROUNDING_NS), Schedule(rate_hz)
    for k in range(300):
        # as a container in ms keeps them, with an offset
        stamp_ns = round((k % 100) * 1e9 / rate_hz / MS) * MS + 40 * MS
        # a ns of rounding a round
        assert abs(schedule.due_ns(k % 100, stamp_ns) - even.due_ns(k)) <= 3


@given(
    st.floats(1, 500),
    st.lists(st.tuples(st.integers(-(10**10), 10**10), st.booleans()), min_size=2, max_size=60),
)
def test_due_times_always_grow(rate_hz: float, steps: list[tuple[int, bool]]) -> None:
    schedule = Schedule(rate_hz, STAMP_ROUNDING_NS)
    due = list[int]()
    index = -1
    for stamp_ns, restart in steps:
        index = 0 if restart else index + 1
        due.append(schedule.due_ns(index, stamp_ns))
    assert all(later > earlier for earlier, later in pairwise(due))


# frames passed on, how late each is in ms, how far the schedule has moved in ns
Played = tuple[list[int], list[float], int]


def _played(
    rate_hz: float, decode_ms: float, seconds: float, stall: tuple[int, float] = (-1, 0.0)
) -> Played:
    """A recording, played by a reader that takes decode_ms a frame.

    stall: (frame, seconds) of a pause before it.
    """
    schedule = Schedule(rate_hz)
    lateness = Lateness(int(2e9 / rate_hz))
    t_ns = 0
    passed = []
    late_ms = []
    k = 0
    while t_ns < seconds * 1e9:
        t_ns += int(decode_ms * 1e6) + int(stall[1] * 1e9) * (k == stall[0])
        due_ns = schedule.due_ns(k)
        t_ns = max(t_ns, due_ns + lateness.moved_ns)
        if not lateness.drops(due_ns, t_ns):
            passed.append(k)
            late_ms.append((t_ns - due_ns - lateness.moved_ns) / 1e6)
        k += 1
    return passed, late_ms, lateness.moved_ns


def test_after_a_hiccup_frames_are_dropped_until_the_recording_has_caught_up() -> None:
    passed, late_ms, moved_ns = _played(30, 5, 10)
    assert passed == list(range(len(passed))) and max(late_ms[1:]) == 0 and moved_ns == 0, (
        "in time it loses nothing"
    )
    passed, late_ms, moved_ns = _played(30, 5, 10, (50, 0.3))
    missing = sorted(set(range(passed[-1])) - set(passed))
    assert missing == list(range(50, 50 + len(missing))) and 5 <= len(missing) <= 10
    assert max(late_ms) <= 2000 / 30 and moved_ns == 0, "the schedule stands"


def test_a_recording_that_stood_still_goes_on_where_it_stood() -> None:
    passed, _, moved_ns = _played(30, 5, 10, (50, 3.0))
    assert passed == list(range(len(passed))) and 2.9e9 < moved_ns < 3.1e9


def test_a_reader_too_slow_for_the_pace_gets_most_frames_and_no_old_ones() -> None:
    """It used to get one frame a second: all others were late, and dropped."""
    passed, late_ms, _ = _played(120, 12, 10)
    assert len(passed) > 0.7 * 10 / 0.012 and max(late_ms) <= 2000 / 120
