"""The screen's blanks and when to begin a picture: a grid from noisy reports, a lead learnt from a simulated compositor."""

import numpy as np
import pytest

from lfpipe.bench.judder import T0_NS, simulate
from lfpipe.render.refresh import LeadTime, ScreenClock, ScreenRefresh

MS = 1_000_000


def grid(rate_hz: float, count: int, jitter_ns: float, seed: int = 1, shown: float = 1.0) -> list[int]:
    """Times of blanks; a share `shown` of them is reported."""
    random = np.random.default_rng(seed)
    ticks = np.flatnonzero(random.random(count) < shown)
    return [round(T0_NS + k * 1e9 / rate_hz + random.uniform(-jitter_ns, jitter_ns)) for k in ticks]


@pytest.mark.parametrize(("rate_hz", "nominal_hz"), [(59.94, 60), (75.0, 75), (71.4, 75), (143.98, 144), (23.976, 24)])
@pytest.mark.parametrize("shown", [1.0, 0.3])
def test_the_grid_is_found_from_stamps_in_whole_ms(rate_hz: float, nominal_hz: float, shown: float) -> None:
    clock = ScreenClock(nominal_hz, T0_NS - 3 * MS)
    blanks = grid(rate_hz, 4000, 0.5 * MS, shown=shown)
    for t_ns in blanks:
        clock.blank(t_ns)
    assert clock.measured and clock.rate_hz == pytest.approx(rate_hz, rel=2e-3)
    k = round((blanks[-1] - T0_NS) * rate_hz / 1e9)
    true_ns = T0_NS + (k + 1) * 1e9 / rate_hz
    assert abs(clock.nearest(true_ns + 2 * MS) - true_ns) < MS


@pytest.mark.parametrize("reported", [True, False])
def test_a_window_on_another_monitor_follows_that_ones_rate(reported: bool) -> None:
    """By the period that is reported, or else by the rate that the monitor claims."""
    clock, later_ns = ScreenClock(60, T0_NS), 10**10
    for t_ns in grid(60.0, 200, 0.2 * MS):
        clock.blank(t_ns, 16_666_667 * reported)
        clock.claim(60)
    assert clock.measured
    if not reported:
        clock.claim(75)
        assert not clock.measured and clock.rate_hz == pytest.approx(75)
    other = grid(71.4, 600, 0.2 * MS)
    for t_ns in other:
        clock.blank(t_ns + later_ns, 14_005_602 * reported)
    assert clock.rate_hz == pytest.approx(71.4, rel=2e-3)
    assert abs(clock.nearest(other[-1] + later_ns) - other[-1] - later_ns) < 0.5 * MS


def test_blanks_that_are_on_no_grid_change_nothing_but_another_phase_is_followed() -> None:
    clock = ScreenClock(60, T0_NS)
    for t_ns in grid(60.0, 100, 0):
        clock.blank(t_ns)
    before = clock.nearest(T0_NS)
    clock.blank(T0_NS + 2 * 10**9 + 8 * MS)
    assert clock.nearest(T0_NS) == before
    moved = [T0_NS + 3 * 10**9 + 8 * MS + round(k * 1e9 / 60) for k in range(20)]
    for t_ns in moved:
        clock.blank(t_ns)
    assert abs(clock.nearest(moved[-1]) - moved[-1]) < MS // 10


@pytest.mark.parametrize(
    ("rate_hz", "deadline_ms"), [(60.0, 0.0), (60.0, 3.0), (75.0, 6.0), (144.0, 3.0), (60.0, 18.0)]
)  # the last one takes pictures a period ahead
def test_pictures_begin_late_and_still_make_their_blank(rate_hz: float, deadline_ms: float) -> None:
    shown = simulate(rate_hz, deadline_ms, 6000)
    assert shown.juddered <= 0.005
    assert deadline_ms + 1.0 < shown.lead_ms < deadline_ms + 4.0


@pytest.mark.parametrize(("slow", "most"), [(0.02, 0.02), (0.1, 0.05), (0.3, 0.12)])
def test_a_busy_machine_costs_a_picture_now_and_then_and_never_runs_away(slow: float, most: float) -> None:
    """slow: share of wake-ups that come 5 ms late on average."""
    shown = simulate(60.0, 3.0, 4000, slow=slow)
    assert shown.juddered <= most
    assert shown.lead_ms < 3.0 + 16.7 + 3.0


def test_a_lead_that_is_far_too_long_shrinks_to_what_is_needed() -> None:
    lead, wide_ns = LeadTime(), 0
    for k in range(80):  # late, each begun after the one before; then a period early
        t_ns, late_ms = k * 100 * MS, 17 if k < 40 else -17
        wide_ns = max(wide_ns, lead.ns)
        lead.judge(t_ns, t_ns - 30 * MS, t_ns + late_ms * MS, 16.7 * MS)
    assert wide_ns > 30 * MS and lead.ns < 5 * MS


def test_refreshes_that_were_slept_through_are_missed_and_a_limit_takes_every_second() -> None:
    clock = ScreenClock(60.0, T0_NS)
    clock.blank(T0_NS)
    refresh = ScreenRefresh(clock, 30.0, T0_NS)
    assert refresh.period_ns == pytest.approx(2e9 / 60, abs=2)
    refresh.advance(T0_NS)
    first_ns = refresh.due_ns()
    refresh.advance(first_ns + round(4e9 / 60))
    assert refresh.missed == 2 and refresh.due_ns() - first_ns == pytest.approx(6e9 / 60, abs=4), (
        "a picture begun now is too late"
    )
