"""The viewer's states, by their transitions, and the easing of the view: lost and found again,
nothing jumps.
"""

import pytest

from lfpipe.render.synthesis.viewpoint import Place
from lfpipe.render.viewer.presence import (
    Presence,
    RestingEyes,
    ViewEasing,
    ViewerState,
)

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


NEUTRAL: Place = (4.0, 2.0, 6.0)


def test_view_easing_holds_a_lost_view_for_three_seconds() -> None:
    easing = ViewEasing()
    seen = NEUTRAL[0], NEUTRAL[1] + 2.0, NEUTRAL[2] + 2.0
    easing.followed(0, seen, lambda dt_s: (0.0, 0.0, 0.0))
    places = [easing.alone(round(t_s * 1e9), NEUTRAL) for t_s in (0.0, 2.9, 3.5, 15.0)]
    assert places[0] == places[1] == seen
    assert seen[1] - 1.0 < places[2][1] < seen[1] - 0.1
    assert places[3] == pytest.approx(NEUTRAL, abs=1e-3)
