"""A simulated screen: vertical blanks at a rate that may drift or change, a compositor that shows
the newest or the oldest picture, and a render loop that draws pictures of a given cost by
`ScreenRefresh`.
"""

from typing import NamedTuple

import attrs
import numpy as np

from lfpipe.bench.simulator.camera import T0_NS
from lfpipe.host.presentation import Presented
from lfpipe.render.display.refresh import ScreenRefresh
from lfpipe.transport.ring import MS_NS, SECOND_NS

WAKE_MS, LATE_WAKE_MS = 0.1, 5.0  # mean lateness of wake-ups
SETTLED_S = 5.0


@attrs.frozen(kw_only=True)
class SimulatedScreen:
    """A screen and its window system."""

    rate_hz: float
    claimed_hz: float
    """The rate that the window system names at first."""
    drift: float = 0.0
    moves_to_hz: float = 0.0
    """Rate of the screen that the window moves to after MOVES_S; 0: it does not move."""
    queue: int = 0
    """Pictures in flight, of which each vertical blank shows the oldest; a submission waits while
    there are as many. 0: the newest is shown."""
    deadline_ms: float = 3.0
    """A picture appears at a vertical blank if it is submitted this long before it."""
    late_wakes: float = 0.0
    """Share of wake-ups that are LATE_WAKE_MS late in the mean."""

    MOVES_S = 8.0

    def vblanks(self, seconds: float) -> tuple[list[int], list[float]]:
        """Times of the vertical blanks, ns, and the rate at each."""
        times, rates = [], []
        t_ns = T0_NS + 0.37e9 / self.rate_hz
        while t_ns < T0_NS + seconds * SECOND_NS:
            moved = self.moves_to_hz and t_ns > T0_NS + self.MOVES_S * SECOND_NS
            rates.append(self.moves_to_hz if moved else self.rate_hz)
            t_ns += 1e9 / rates[-1] * (1 + self.drift)
            times.append(round(t_ns))
        return times, rates


class Shown(NamedTuple):
    """What became of the pictures, once settled."""

    late: float
    """Share that appeared at another vertical blank than planned."""
    wait: float
    """Mean time from submission to appearance, in periods."""


def shown(screen: SimulatedScreen, cost_ms: float, seconds: float = 25.0) -> Shown:
    """Draws pictures of cost_ms on a screen."""
    random = np.random.default_rng(1)
    refresh = ScreenRefresh(screen.claimed_hz, T0_NS)
    times, rates = screen.vblanks(seconds)
    judged_from_ns = T0_NS + round(
        ((screen.MOVES_S if screen.moves_to_hz else 0.0) + SETTLED_S) * SECOND_NS
    )
    pending: list[tuple[int, int, int]] = []  # (number, due, submitted)
    now_ns, number, vblank = T0_NS, 0, 0
    late: list[bool] = []
    waits: list[float] = []
    while now_ns < times[-1]:
        due_ns = refresh.due_ns()
        wake_ms = random.exponential(WAKE_MS)
        if screen.late_wakes and random.random() < screen.late_wakes:
            wake_ms += random.exponential(LATE_WAKE_MS)
        begun_ns = max(now_ns, due_ns - refresh.lead_ns()) + round(wake_ms * MS_NS)
        cost_ns = round(cost_ms * random.lognormal(0, 0.1) * MS_NS)
        now_ns = max(begun_ns + cost_ns, refresh.earliest_ns(due_ns))
        refresh.add_cost(cost_ns)
        number += 1
        handed_ns = now_ns
        pending.append((number, due_ns, handed_ns))
        reports: list[Presented] = []
        judged: list[tuple[int, int, int]] = []
        while vblank < len(times) and (times[vblank] <= now_ns or 0 < screen.queue < len(pending)):
            t_ns = times[vblank]
            now_ns = max(now_ns, t_ns)
            ready = [one for one in pending if one[2] + screen.deadline_ms * MS_NS <= t_ns]
            if screen.queue:
                ready = ready[:1]
            period_ns = round(1e9 / rates[vblank])
            for one in ready:
                shown_ns = t_ns if one is ready[-1] else 0
                reports.append(Presented(one[0], shown_ns, period_ns if shown_ns else 0))
                judged.append((one[1], one[2], shown_ns))
                if shown_ns and one[2] > judged_from_ns:
                    waits.append((shown_ns - one[2]) * rates[vblank] / SECOND_NS)
            pending = pending[len(ready) :]
            vblank += 1
        refresh.vblanks(reports)
        for due, submitted, shown_ns in judged:
            is_late = refresh.judge(due, submitted, shown_ns)
            if submitted > judged_from_ns:
                late.append(is_late)
        refresh.advance(now_ns)
    return Shown(float(np.mean(late)), float(np.mean(waits)))
