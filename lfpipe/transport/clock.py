"""One clock for every process: CLOCK_MONOTONIC as int64 nanoseconds. Subtract first, then convert
to float seconds.
"""

import time
from collections.abc import Callable

from lfpipe.host.machine import asleep_ns

# of the machine, not of the process: stamps of different processes are comparable
now_ns = time.monotonic_ns
SECOND_NS = 1_000_000_000
MS_NS = 1_000_000
POLL_S = 0.001  # between two looks at a ring whose writer wakes nobody
SLEPT_NS = SECOND_NS // 2  # the gap after which filters are reset


def sleep_until(t_ns: int) -> None:
    """Sleeps until an absolute time; returns at once if it has passed."""
    wait_ns = t_ns - now_ns()
    if wait_ns > 0:
        time.sleep(wait_ns / 1e9)


class SleepWatch:
    """Detects that the machine was suspended. asleep: a function like `asleep_ns`."""

    def __init__(self, asleep: Callable[[], int] = asleep_ns) -> None:
        self._asleep = asleep
        self._known_ns = asleep()

    def woke(self) -> bool:
        """Whether the machine was suspended for at least SLEPT_NS since the last call that returned
        True.
        """
        slept_ns = self._asleep()
        if slept_ns - self._known_ns < SLEPT_NS:
            return False
        self._known_ns = slept_ns
        return True


class Ticker:
    """Absolute deadlines t0 + k * period without drift. Missed deadlines are skipped."""

    def __init__(self, rate_hz: float, t0_ns: int) -> None:
        self._rate_hz = rate_hz
        self._t0_ns = t0_ns
        self._k = 0

    def due_ns(self) -> int:
        """The next deadline."""
        return self._t0_ns + int(self._k * 1e9 / self._rate_hz)

    def advance(self, t_ns: int) -> None:
        """Advances to the first later deadline that is not yet past at t_ns."""
        self._k = max(self._k, int((t_ns - self._t0_ns) * self._rate_hz / 1e9)) + 1
