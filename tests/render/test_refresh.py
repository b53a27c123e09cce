"""The display's clock. Beside a camera's, the phase is found at once, then followed in small steps;
outliers are ignored. On a screen's vblanks: a grid from noisy reports, and a lead learnt from a
simulated compositor. Each submitted picture is reported once, in order, by its vblank or by its
submission.
"""

from collections import deque

import pytest

from lfpipe.bench.simulator.camera import T0_NS
from lfpipe.host.presentation import Presented
from lfpipe.render.display.refresh import ScreenRefresh
from lfpipe.render.presenter import ANSWER_NS, HANDOVER, REPLACED, Presentation, pop_timed
from tests.render import rendered
from tests.render.simulated_screen import SimulatedScreen, shown


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
        for one in pop_timed(waiting, answers, "vblanks", t_ns)
    ]


def test_pop_timed_waits_for_a_vblank_in_order() -> None:
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


def test_pop_timed_of_replaced_and_unanswered_pictures() -> None:
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
            SimulatedScreen(rate_hz=60, claimed_hz=60, moves_to_hz=rate_hz)
            for rate_hz in (30, 75, 144)
        ),
    ],
    ids=str,
)
def test_screen_refresh_finds_the_vblanks_of_any_screen_in_5_s(screen: SimulatedScreen) -> None:
    assert shown(screen, 3.0).late <= 0.02
