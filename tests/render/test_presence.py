"""The viewer's states, by their transitions, and the easing of the view: lost and found again,
nothing jumps.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.render.synthesis.viewpoint import Place
from lfpipe.render.viewer.presence import (
    EASED_VIEWS,
    Presence,
    RestingEyes,
    ViewEasing,
    ViewerState,
)
from tests.support.examples import examples

HOME = RestingEyes(300.0, 200.0, 60.0)
N, A, SE, L, E = ViewerState


def watched(*faces: tuple[RestingEyes | None, float, int]) -> tuple[Presence, RestingEyes | None]:
    """The state after (place, seconds, generation) of each face, and the last rest measured."""
    subject = Presence()
    t_ns = 0
    rest = None
    for here, seconds, generation in faces:
        for _ in range(int(seconds * 30) + 1):
            t_ns += 33_333_333
            rest = subject.update(t_ns, here, generation)
    return subject, rest


@pytest.mark.parametrize(
    ("away_s", "state"), [(1.0, SE), (9.8, SE), (10.2, A)], ids=["a hand", "before", "after"]
)
def test_presence_keeps_a_seat_for_ten_seconds_of_absence(
    away_s: float, state: ViewerState
) -> None:
    assert watched((HOME, 3.0, 0), (None, away_s, 0))[0].state is (L if state is SE else N)
    assert watched((HOME, 3.0, 0), (None, away_s, 0), (HOME, 0.0, 1))[0].state is state


@pytest.mark.parametrize(
    ("back", "away_s", "returns"),
    [
        (RestingEyes(310.0, 200.0, 62.0), 2.0, True),
        (RestingEyes(310.0, 200.0, 62.0), 28.0, True),
        (RestingEyes(420.0, 200.0, 62.0), 2.0, False),
        (RestingEyes(305.0, 200.0, 80.0), 2.0, False),
        (RestingEyes(305.0, 200.0, 60.0), 32.0, False),
    ],
    ids=["soon", "in half a minute", "elsewhere", "nearer", "later"],
)
def test_presence_seats_a_returning_viewer_at_once(
    back: RestingEyes, away_s: float, returns: bool
) -> None:
    """While another face is there."""
    subject, rest = watched(
        (HOME, 3.0, 0), (RestingEyes(500.0, 210.0, 90.0), away_s, 1), (back, 0.0, 2)
    )
    assert (subject.state is SE and rest is not None and rest.x_px == HOME.x_px) == returns


STEP_NS = 16_666_667
NEUTRAL: Place = (4.0, 2.0, 6.0)


def run(
    easing: ViewEasing,
    start: int,
    count: int,
    target: Place | None,
    motion: float = 0.0,
    step_ns: int = STEP_NS,
) -> np.ndarray:
    """The places shown at count refreshes. motion: views per second that the columns explain."""
    shown = []
    for k in range(start, start + count):
        if target is None:
            shown.append(easing.alone(k * step_ns, NEUTRAL))
        else:
            shown.append(
                easing.followed(
                    k * step_ns, target, lambda dt_s: (0.0, motion * dt_s, motion * dt_s)
                )
            )
    return np.array(shown)


@given(
    st.lists(
        st.tuples(st.booleans(), st.integers(1, 40), st.floats(-4, 4)), min_size=1, max_size=12
    )
)
@examples(80)
def test_view_easing_never_jumps(spans: list[tuple[bool, int, float]]) -> None:
    """Faces come and go anywhere within 8 views: no picture leaps, none moves away from its target,
    and half a second later it is there.
    """
    easing = ViewEasing()
    start = 0
    shown = list(run(easing, 0, 1, NEUTRAL))
    for face, count, aside in spans:
        row, left, right = NEUTRAL
        target = (row, left + aside, right + aside) if face else None
        new = run(easing, start, count, target)
        start += count
        if target is not None:
            left_views = np.abs(np.array([shown[-1], *new]) - target).max(axis=1)
            assert np.all(np.diff(left_views) <= 1e-9) and (count < 30 or left_views[-1] == 0)
        shown += list(new)
    assert np.abs(np.diff(shown, axis=0)).max() <= EASED_VIEWS + 1e-9


def test_view_easing_holds_a_lost_view_for_three_seconds() -> None:
    easing = ViewEasing()
    seen = NEUTRAL[0], NEUTRAL[1] + 2.0, NEUTRAL[2] + 2.0
    easing.followed(0, seen, lambda dt_s: (0.0, 0.0, 0.0))
    places = [easing.alone(round(t_s * 1e9), NEUTRAL) for t_s in (0.0, 2.9, 3.5, 15.0)]
    assert places[0] == places[1] == seen
    assert seen[1] - 1.0 < places[2][1] < seen[1] - 0.1
    assert places[3] == pytest.approx(NEUTRAL, abs=1e-3)
