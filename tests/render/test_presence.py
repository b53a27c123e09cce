"""The viewer's states, by their transitions, and the easing of the view: lost and found again,
nothing jumps.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from lfpipe.eyes import MAX_STEP_NS
from lfpipe.render.synthesis.viewpoint import Place
from lfpipe.render.viewer.presence import (
    ABSENT_S,
    EASED_VIEWS,
    HOLD_S,
    REST_S,
    REST_SPAN,
    RETURN_SPAN,
    Presence,
    Rest,
    ViewEasing,
    ViewerState,
    idle_place,
)
from tests.support.examples import examples

FRAME_NS = 33_333_333
HOME = Rest(300.0, 200.0, 60.0)
N, A, SE, L, E = ViewerState
ALLOWED = {N: {N, A}, A: {A, SE, L, E}, SE: {SE, L, E}, L: {L, N, A, SE, E}, E: {E, SE, L}}


class Watched(RuleBasedStateMachine):
    """Checks that every transition is in the table, and that rests are measured exactly at the
    table's transitions.
    """

    def __init__(self) -> None:
        super().__init__()
        self.subject = Presence()
        self.t_ns = self.seen_ns = 0
        self.generation = 0
        self.x, self.measured = 300.0, False
        self.exchanged = False
        # until somebody has rested in a seat that was taken again, or left for HOLD_S
        self.unconfirmed = False

    def frame(self, here: Rest | None, beyond: bool = False) -> Rest | None:
        self.t_ns += FRAME_NS
        before = self.subject.state
        rest = self.subject.update(self.t_ns, here, self.generation, beyond)
        after = self.subject.state
        assert after in ALLOWED[before], f"{before.word} to {after.word}"
        if here is not None:
            self.unconfirmed |= before is L and self.t_ns - self.seen_ns >= HOLD_S * 1e9
            self.seen_ns = self.t_ns
        if rest is not None:
            assert after is SE and here is not None
            assert before in (A, E, L) or beyond or self.exchanged or self.unconfirmed, (
                "a seated viewer is measured anew beyond the grid alone"
            )
            span = RETURN_SPAN if self.subject.returned else 2 * REST_SPAN
            assert self.exchanged or abs(rest.x_px - here.x_px) <= span * here.eye_distance_px
        if here is None:
            assert after in (N, L)
        self.unconfirmed = self.subject.returned or (self.unconfirmed and rest is None)
        return rest

    @rule(seconds=st.floats(0.1, 3.0))
    def sits(self, seconds: float) -> None:
        measured = [self.frame(Rest(self.x, 200.0, 60.0)) for _ in range(int(seconds * 30))]
        if seconds > REST_S + 0.2:
            assert self.subject.state is SE
            assert len([rest for rest in measured if rest]) <= 1

    @rule(seconds=st.floats(0.1, 2.0), speed=st.floats(80.0, 400.0))
    def walks(self, seconds: float, speed: float) -> None:
        for _ in range(int(seconds * 30)):
            self.x += speed / 30
            self.frame(Rest(self.x, 200.0, 60.0))

    @rule(seconds=st.floats(0.05, 5.0))
    def hides(self, seconds: float) -> None:
        for _ in range(max(int(seconds * 30), 1)):
            self.frame(None)

    @rule()
    def leaves(self) -> None:
        self.hides(ABSENT_S + 0.2)
        assert self.subject.state is N

    @precondition(lambda self: self.subject.state not in (N, L))
    @rule(x=st.floats(50.0, 600.0))
    def is_exchanged(self, x: float) -> None:
        self.generation = self.generation + 1
        self.x = x
        self.exchanged = True
        back = self.frame(Rest(self.x, 200.0, 60.0))
        assert self.subject.state is (E if back is None else SE), (
            "another face, or the one that sat there"
        )
        self.exchanged = False

    @rule(seconds=st.floats(MAX_STEP_NS / 1e9 + 0.1, 5.0))
    def camera_stands_still(self, seconds: float) -> None:
        """No frames: whoever is seen afterwards, in a new track, counts as the same viewer."""
        before = self.subject.state
        self.t_ns += int(seconds * 1e9)
        self.generation += 1
        self.frame(Rest(self.x, 200.0, 60.0))
        if before in (A, SE, E):
            assert self.subject.state is before

    @rule(seconds=st.floats(1.3, 2.0))
    def rests_beyond_the_grid(self, seconds: float) -> None:
        found = [
            self.frame(Rest(self.x, 200.0, 60.0), beyond=True) for _ in range(int(seconds * 30))
        ]
        assert any(found) and self.subject.state is SE


Watched.TestCase.settings = examples(60, stateful_step_count=20)
TestPresence = Watched.TestCase


def watched(*faces: tuple[Rest | None, float, int]) -> tuple[Presence, Rest | None]:
    """The state after (place, seconds, generation) of each face, and the last rest measured."""
    subject = Presence()
    t_ns = 0
    rest = None
    for here, seconds, generation in faces:
        for _ in range(int(seconds * 30) + 1):
            t_ns += FRAME_NS
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
    ("back", "away_s", "known"),
    [
        (Rest(310.0, 200.0, 62.0), 2.0, True),
        (Rest(310.0, 200.0, 62.0), 28.0, True),
        (Rest(420.0, 200.0, 62.0), 2.0, False),
        (Rest(305.0, 200.0, 80.0), 2.0, False),
        (Rest(305.0, 200.0, 60.0), 32.0, False),
    ],
    ids=["soon", "in half a minute", "elsewhere", "nearer", "later"],
)
def test_presence_seats_a_returning_viewer_at_once(back: Rest, away_s: float, known: bool) -> None:
    """While another face is there."""
    subject, rest = watched((HOME, 3.0, 0), (Rest(500.0, 210.0, 90.0), away_s, 1), (back, 0.0, 2))
    assert (subject.state is SE and rest is not None and rest.x_px == HOME.x_px) == known


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


@given(
    rows=st.integers(1, 17),
    cols=st.integers(1, 17),
    t_s=st.floats(0, 1e5),
    at=st.tuples(*[st.floats(0, 1)] * 3),
)
def test_idle_place_stays_in_the_grid(
    rows: int, cols: int, t_s: float, at: tuple[float, float, float]
) -> None:
    """Wherever the last viewer left the picture."""
    row, first, second = (
        share * (size - 1) for share, size in zip(at, (rows, cols, cols), strict=True)
    )
    place = idle_place((row, min(first, second), max(first, second)), (rows, cols), t_s)
    assert 0 <= place[0] <= rows - 1
    assert all(0 <= col <= cols - 1 for col in place[1:])
