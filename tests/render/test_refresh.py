"""The display's clock. Beside a camera's, the phase is found at once, then followed in small steps;
outliers are ignored. On a screen's vblanks: a grid from noisy reports, and a lead learnt from a
simulated compositor. Each submitted picture is reported once, in order, by its vblank or by its
submission.
"""

from collections import deque
from itertools import pairwise

import numpy as np
import pytest

from lfpipe.bench.simulator.camera import T0_NS
from lfpipe.host.presentation import Presented
from lfpipe.render.display.refresh import (
    Refresh,
    ScreenClock,
    ScreenRefresh,
)
from lfpipe.render.presenter import ANSWER_NS, HANDOVER, REPLACED, Presentation, take_known
from tests.render import rendered
from tests.render.simulated_screen import SimulatedScreen, shown

MS = 1_000_000
AGE_NS = 5 * MS  # from a frame's stamp to its eyes


def off(refresh: Refresh, t_sensor_ns: int) -> float:
    """How far a refresh is from being due just after the eyes of that frame are drawn, in periods,
    -0.5 to 0.5.
    """
    slack_ns = min(0.2 * refresh.period_ns, 3 * MS)
    away = (
        refresh.due_ns() - (t_sensor_ns + AGE_NS + refresh.lead_ns() + slack_ns)
    ) / refresh.period_ns
    return float((away + 0.5) % 1 - 0.5)


def test_refresh_due_ns_increases_for_any_camera_stamps() -> None:
    rng = np.random.default_rng(3)
    refresh = Refresh(60.0, T0_NS)
    t_ns = T0_NS
    last = 0
    dues = []
    for _ in range(2000):
        t_ns += int(rng.integers(0, 100 * MS))
        last += int(rng.integers(-2, 4))
        refresh.add_eyes(last, t_ns - int(rng.integers(0, 50 * MS)), t_ns)
        refresh.add_cost(int(rng.integers(0, 30 * MS)), 0, 0)
        while refresh.due_ns() <= t_ns:
            dues.append(refresh.due_ns())
            refresh.advance(refresh.due_ns())
    assert all(b > a for a, b in pairwise(dues))


def grid(
    rate_hz: float, count: int, jitter_ns: float, seed: int = 1, shown: float = 1.0
) -> list[int]:
    """Times of vblanks; a share `shown` of them is reported."""
    random = np.random.default_rng(seed)
    ticks = np.flatnonzero(random.random(count) < shown)
    return [round(T0_NS + k * 1e9 / rate_hz + random.uniform(-jitter_ns, jitter_ns)) for k in ticks]


def test_screen_clock_ignores_a_stray_vblank_and_follows_a_phase() -> None:
    clock = ScreenClock(60, T0_NS)
    for t_ns in grid(60.0, 100, 0):
        clock.vblank(t_ns)
    before = clock.nearest(T0_NS)
    clock.vblank(T0_NS + 2 * 10**9 + 8 * MS)
    assert clock.nearest(T0_NS) == before
    moved = [T0_NS + 3 * 10**9 + 8 * MS + round(k * 1e9 / 60) for k in range(20)]
    for t_ns in moved:
        clock.vblank(t_ns)
    assert abs(clock.nearest(moved[-1]) - moved[-1]) < MS // 10


class Composed:
    """A refresh on vblanks, and pictures that cost time."""

    def __init__(self) -> None:
        self.refresh = ScreenRefresh(60.0, T0_NS)
        self.refresh.clock.vblank(T0_NS)
        self.due_ns = T0_NS

    def compose(self, cost_ms: float, late_by: int = 0) -> int:
        """The lead after a picture that is shown so many vblanks late."""
        self.due_ns = self.refresh.clock.nearest(self.due_ns + 16_666_667)
        start_ns = self.due_ns - self.refresh.lead_ns()
        cost_ns = round(cost_ms * MS)
        self.refresh.add_cost(cost_ns, start_ns, self.due_ns)
        self.refresh.judge(self.due_ns, start_ns + cost_ns, self.due_ns + late_by * 16_666_667)
        return self.refresh.lead_ns()


def test_screen_refresh_lead_is_not_lengthened_by_a_stall() -> None:
    made = Composed()
    before_ns = [made.compose(4.0) for _ in range(2000)][-1]
    after_ns = [made.compose(cost_ms) for cost_ms in (30.0, 12.0, 4.0, 4.0, 4.0, 4.0, 4.0)][-1]
    assert after_ns - before_ns <= MS // 2
    stays_ns = [made.compose(8.0) for _ in range(100)][-1]
    assert stays_ns - before_ns >= 3 * MS, "but a cost that stays is followed"


def test_screen_refresh_lead_forgets_a_busy_start() -> None:
    made = Composed()
    # scenes are packed, stages start
    assert [made.compose(10.0, late_by=k % 30 == 0) for k in range(240)][-1] >= 14 * MS
    assert [made.compose(4.0) for _ in range(1500)][-1] <= 9 * MS, "after 25 s"


def test_screen_refresh_lead_shrinks_to_what_is_needed() -> None:
    refresh = ScreenRefresh(60.0, T0_NS)
    wide_ns = 0
    refresh.clock.vblank(T0_NS)
    for k in range(120):  # late, each begun after the one before; then a period early
        t_ns = k * 100 * MS
        late_ms = 17 if k < 80 else -17
        wide_ns = max(wide_ns, refresh.lead_ns())
        refresh.judge(t_ns, t_ns - 30 * MS, t_ns + late_ms * MS)
    assert wide_ns > 30 * MS and refresh.lead_ns() < 5 * MS


def test_screen_refresh_lead_widens_where_a_picture_is_replaced() -> None:
    refresh = ScreenRefresh(60.0, T0_NS)
    refresh.clock.vblank(T0_NS)
    before_ns = refresh.lead_ns()
    for k in range(10, 60, 2):  # every second one is replaced, its successor is in time
        due_ns = refresh.clock.nearest(T0_NS + k * 16_666_667)
        next_ns = refresh.clock.nearest(due_ns + 16_666_667)
        assert refresh.judge(due_ns, due_ns - MS, 0)
        assert not refresh.judge(next_ns, next_ns - 10 * MS, next_ns)
    assert refresh.lead_ns() - before_ns > 5 * MS


def test_screen_refresh_with_a_limit_takes_every_second_vblank() -> None:
    refresh = ScreenRefresh(60.0, T0_NS, 30.0)
    refresh.clock.vblank(T0_NS)
    assert refresh.period_ns == pytest.approx(2e9 / 60, abs=2)
    refresh.advance(T0_NS)
    first_ns = refresh.due_ns()
    assert refresh.advance(first_ns + round(4e9 / 60)) == 2, "a picture begun now is too late"
    assert refresh.due_ns() - first_ns == pytest.approx(6e9 / 60, abs=4)


def presentation(number: int, t_ns: int, by: str = "") -> Presentation:
    return rendered.presentation(
        number=number, t_handed_ns=t_ns, t_presented_ns=t_ns if by else 0, by=by
    )


def known(
    waiting: deque[Presentation], answers: list[Presented], t_ns: int
) -> list[tuple[int, int, str]]:
    return [
        (one.t_handed_ns, one.t_presented_ns, one.by)
        for one in take_known(waiting, answers, "vblanks", t_ns)
    ]


def test_take_known_waits_for_a_vblank_in_order() -> None:
    waiting = deque((presentation(1, 100), presentation(0, 200, "vblanks"), presentation(2, 300)))
    assert known(waiting, [Presented(2, 350, 0)], 360) == []
    assert known(waiting, [Presented(1, 150, 0)], 370) == [
        (100, 150, "vblanks"),
        (200, 200, "vblanks"),
        (300, 350, "vblanks"),
    ]
    assert known(waiting, [Presented(1, 999, 0), Presented(7, 1, 0)], 380) == [], (
        "an answer twice, and one to nothing"
    )


def test_take_known_of_replaced_and_unanswered_pictures() -> None:
    waiting = deque((presentation(1, 100), presentation(2, 200)))
    assert known(waiting, [Presented(1, 0, 0)], 300) == [(100, 0, REPLACED)]
    assert known(waiting, [], 200 + ANSWER_NS + 1) == [(200, 200, HANDOVER)]


@pytest.mark.parametrize("rate_hz", [60.0, 144.0])
@pytest.mark.parametrize("periods", [0.2, 0.5, 0.95, 1.05, 1.3, 1.5, 2.0, 3.0])
def test_screen_refresh_is_punctual_at_any_cost_of_a_picture(
    rate_hz: float, periods: float
) -> None:
    screen = SimulatedScreen(rate_hz=rate_hz, claimed_hz=rate_hz)
    assert shown(screen, periods * 1e3 / rate_hz).late <= 0.01


@pytest.mark.parametrize("rate_hz", [60.0, 144.0])
@pytest.mark.parametrize("queue", [1, 2, 3])
@pytest.mark.parametrize("periods", [0.2, 0.5])
def test_screen_refresh_empties_the_queue_of_a_screen(
    rate_hz: float, queue: int, periods: float
) -> None:
    """Each picture was late by a vblank, for good, where the screen shows the oldest one."""
    screen = SimulatedScreen(rate_hz=rate_hz, claimed_hz=rate_hz, queue=queue)
    late, wait = shown(screen, periods * 1e3 / rate_hz)
    assert late <= 0.05 and wait < 1


@pytest.mark.parametrize("deadline_ms", [14.0, 20.0, 30.0])
def test_screen_refresh_takes_a_compositor_that_works_ahead_for_no_queue(
    deadline_ms: float,
) -> None:
    screen = SimulatedScreen(rate_hz=60.0, claimed_hz=60.0, deadline_ms=deadline_ms)
    assert shown(screen, 5.0).late <= 0.01


@pytest.mark.parametrize("queue", [1, 2, 3])
def test_screen_refresh_leaves_a_queue_that_late_wakes_fill(queue: int) -> None:
    screen = SimulatedScreen(rate_hz=144.0, claimed_hz=144.0, queue=queue, late_wakes=0.1)
    assert shown(screen, 1.4).late <= 0.1


@pytest.mark.parametrize(
    "screen",
    [
        SimulatedScreen(rate_hz=59.94, claimed_hz=60),
        SimulatedScreen(rate_hz=60, claimed_hz=60, drift=500e-6),
        *(SimulatedScreen(rate_hz=rate_hz, claimed_hz=60) for rate_hz in (48, 75, 144)),
        *(
            SimulatedScreen(rate_hz=60, claimed_hz=60, moves_to_hz=rate_hz, claims_move=claims)
            for rate_hz in (30, 75, 144)
            for claims in (True, False)
        ),
    ],
    ids=str,
)
def test_screen_refresh_finds_the_vblanks_of_any_screen_in_5_s(screen: SimulatedScreen) -> None:
    assert shown(screen, 3.0).late <= 0.02
