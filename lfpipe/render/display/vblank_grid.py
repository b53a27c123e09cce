"""The vertical blanks of a screen that reports no period, or a wrong one: found from when pictures
were submitted and when they appeared.
"""

from collections import deque
from collections.abc import Sequence

import attrs
import numpy as np

PICTURES = 48  # of a window: less than a second at 60 Hz
STEP = 12  # pictures between two estimates
MAX_GAP = 10  # periods: after a longer pause the window begins again
MAX_RESIDUAL = 0.08  # of a period: intervals further off are no multiples of it
SHORT = 10  # percentile of the intervals: one period, or a few
DIVISORS = (1, 2, 3)  # all intervals may be multiples of two or three periods
MIN_SPREAD_NS = 150_000  # of submissions: with less, a grid and a fixed delay look alike
FOLLOWING = 0.5  # slope of appearances over submissions: a grid has 0, a screen on demand has 1
SLOWER_SHARE = 0.2  # of replaced pictures: then the screen is slower than pictures come
TOLERANCE = 0.015  # of the period


@attrs.frozen
class Grid:
    """What the pictures of a window show."""

    period_ns: float
    """Time from one possible appearance to the next."""
    is_on_demand: bool
    """Whether pictures appear a fixed time after submission, and not at vertical blanks."""
    skips: bool
    """Whether pictures were replaced before they appeared."""

    def contradicts(self, period_ns: float) -> bool:
        """Whether a screen of that period cannot have shown these pictures. If every second one
        of its vertical blanks gets a picture, it can.
        """
        ratio = self.period_ns / period_ns
        nearest = 1 if self.skips or ratio < 1 else round(ratio)
        return not self.is_on_demand and abs(ratio / nearest - 1) > TOLERANCE


class GridEstimator:
    """Estimates the grid from the last PICTURES pictures."""

    def __init__(self) -> None:
        self._pictures = deque[tuple[int, int]](maxlen=PICTURES)
        self._replaced = self._added = 0

    def reset(self) -> None:
        """Begins a new window."""
        self._pictures.clear()
        self._replaced = self._added = 0

    def add(self, t_handed_ns: int, t_presented_ns: int) -> Grid | None:
        """Adds a picture; t_presented_ns: 0 for a replaced one. Returns an estimate every STEP
        pictures, as far as there is one.
        """
        if not t_presented_ns:
            self._replaced += 1
            return None
        self._pictures.append((t_handed_ns, t_presented_ns))
        self._added += 1
        if len(self._pictures) < PICTURES or self._added % STEP:
            return None
        grid = _fitted(self._pictures, self._replaced > SLOWER_SHARE * self._added)
        if grid is None or self._added > 4 * PICTURES:
            self._replaced = self._added = 0
        return grid


def _fitted(pictures: Sequence[tuple[int, int]], skips: bool) -> Grid | None:
    handed, shown = (np.array(times, np.float64) for times in zip(*pictures, strict=True))
    handed, shown = handed - shown[0], shown - shown[0]
    gaps = np.diff(shown)
    short_ns = float(np.percentile(gaps, SHORT, method="lower"))
    if short_ns <= 0 or gaps.max() > MAX_GAP * short_ns:
        return None
    for divisor in DIVISORS:
        counts = np.rint(gaps * (divisor / short_ns))
        numbers = np.concatenate(([0.0], np.cumsum(counts)))
        slope_ns, start_ns = np.polyfit(numbers, shown, 1)
        off_ns = shown - start_ns - slope_ns * numbers
        if np.abs(np.diff(off_ns)).mean() < MAX_RESIDUAL * slope_ns:
            break
    else:
        return None
    wait_ns = handed - start_ns - slope_ns * numbers
    wait_ns -= wait_ns.mean()
    if wait_ns.std() < MIN_SPREAD_NS:
        return None
    follows = float(off_ns @ wait_ns / (wait_ns @ wait_ns))
    return Grid(float(slope_ns), follows > FOLLOWING, skips)
