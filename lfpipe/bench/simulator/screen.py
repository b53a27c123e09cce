"""The simulated screen: vblanks at an even rate, which the product's own clock must track."""

import math

import attrs
import numpy as np

from lfpipe.bench.simulator.camera import T0_NS
from lfpipe.render.display.refresh import ScreenRefresh
from lfpipe.transport.ring import MS_NS

COST_SPREAD = 0.2  # standard deviation of the logarithm of a picture's cost
WAKE_MS = 0.1  # lateness of wake-ups on a quiet machine
SLOW_MS = 5.0  # lateness of slow wake-ups on a busy machine


@attrs.frozen(kw_only=True)
class Screen:
    """A screen and its compositor."""

    rate_hz: float = 60.0
    device_latency_ms: float = 80.0
    """Delay of camera and display together."""
    slow: float = 0.0
    """Share of late wake-ups."""
    deadline_ms: float = 3.0
    """A picture appears at a vblank if it is submitted this long before it."""
    cost_ms: float = 1.5
    """CPU time of a picture: warp2 at 512x512."""

    @property
    def period_ns(self) -> float:
        return 1e9 / self.rate_hz

    def vblank_ns(self, vblank: int) -> int:
        """The time of a vblank, counted from the start."""
        return round(T0_NS + vblank * self.period_ns)


class PacedScreen:
    """Runs `ScreenRefresh` against a screen: `begin` returns the start time of a picture, `submit`
    the vblank at which it appears.
    """

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._random = np.random.default_rng(5)
        self.refresh = ScreenRefresh(screen.rate_hz, T0_NS)
        self.refresh.clock.vblank(T0_NS)
        self._now_ns = T0_NS
        self.late = 0
        self.missed = 0

    def begin(self) -> tuple[int, int]:
        """(start time of the next picture, time of the vblank that it is due at), ns."""
        refresh = self.refresh
        random = self._random
        due_ns = refresh.due_ns()
        begin_ns = max(self._now_ns, due_ns - refresh.lead_ns())
        late_ms = random.exponential(WAKE_MS)
        late_ms += (random.random() < self._screen.slow) * random.exponential(SLOW_MS)
        self._cost_ms = self._screen.cost_ms * random.lognormal(0, COST_SPREAD)
        return round(begin_ns + late_ms * MS_NS), due_ns

    def submit(self, begun_ns: int, due_ns: int, composed: bool) -> int:
        """Submits the picture; returns the vblank that shows it, counted from the start."""
        refresh = self.refresh
        screen = self._screen
        cost_ns = round(self._cost_ms * MS_NS) * composed
        handed_ns = max(begun_ns + cost_ns, refresh.earliest_ns(due_ns))
        vblank = math.ceil((handed_ns + screen.deadline_ms * MS_NS - T0_NS) / screen.period_ns)
        if composed:
            refresh.add_cost(cost_ns)
            shown_ns = (
                screen.vblank_ns(vblank) // MS_NS * MS_NS + MS_NS // 2
            )  # reported in whole ms
            self.late += refresh.judge(due_ns, handed_ns, shown_ns)
            refresh.clock.vblank(shown_ns)
        self._now_ns = handed_ns
        self.missed += refresh.advance(handed_ns)
        return vblank
