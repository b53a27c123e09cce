"""The viewer's states, by their transitions, and the easing of the view: lost and found again, nothing jumps."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from lfpipe.render.presence import (
    ABSENT_S,
    AWAY_S,
    BACK_S,
    GAP_S,
    HOLD_S,
    REST_S,
    REST_SPAN,
    RETURN_S,
    EyeEasing,
    Presence,
    Rest,
    ViewerState,
)  # fmt: skip

FRAME_NS = 33_333_333
HOME = Rest(300.0, 200.0, 60.0)
N, A, SE, L, E = ViewerState
ALLOWED = {N: {N, A}, A: {A, SE, L, E}, SE: {SE, L, E}, L: {L, N, A, SE, E}, E: {E, SE, L}}


class Watched(RuleBasedStateMachine):
    """Checks that every transition is in the table, and that rests are measured exactly at the table's transitions."""

    def __init__(self) -> None:
        super().__init__()
        self.subject, self.t_ns, self.generation = Presence(), 0, 0
        self.x, self.measured = 300.0, False
        self.exchanged = False

    def frame(self, here: Rest | None, beyond: bool = False) -> Rest | None:
        self.t_ns += FRAME_NS
        before, rest = (
            self.subject.state,
            self.subject.update(self.t_ns, here, self.generation, beyond),
        )
        after = self.subject.state
        assert after in ALLOWED[before], f"{before.word} to {after.word}"
        if rest is not None:
            assert after is SE and here is not None
            assert before in (A, E, L) or beyond or self.exchanged, (
                "a seated viewer is measured anew beyond the grid alone"
            )
            assert self.exchanged or abs(rest.x_px - here.x_px) <= 2 * REST_SPAN * here.apart_px
        if here is None:
            assert after in (N, L)
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
        self.generation, self.x, self.exchanged = self.generation + 1, x, True
        back = self.frame(Rest(self.x, 200.0, 60.0))
        assert self.subject.state is (E if back is None else SE), (
            "another face, or the one that sat there"
        )
        self.exchanged = False

    @rule(seconds=st.floats(GAP_S + 0.1, 5.0))
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


Watched.TestCase.settings = settings(max_examples=60, stateful_step_count=20)
TestPresence = Watched.TestCase


def watched(*faces: tuple[Rest | None, float, int]) -> tuple[Presence, Rest | None]:
    """The state after (place, seconds, generation) of each face, and the last rest measured."""
    subject, t_ns, rest = Presence(), 0, None
    for here, seconds, generation in faces:
        for _ in range(int(seconds * 30) + 1):
            t_ns += FRAME_NS
            rest = subject.update(t_ns, here, generation)
    return subject, rest


def test_a_viewer_found_again_is_the_one_who_was_lost() -> None:
    """A seated viewer stays seated after a hand before the face; after a long absence a viewer arrives."""
    for away_s, then in ((1.0, SE), (ABSENT_S + 1, A)):
        assert watched((HOME, 2.0, 0), (None, away_s, 0), (HOME, 0.0, 1))[0].state is then


def test_who_returns_to_their_seat_is_seated_at_once_and_a_stranger_there_is_not() -> None:
    for place, apart, away_s, known in ((310.0, 62.0, 2.0, True), (420.0, 62.0, 2.0, False), (305.0, 80.0, 2.0, False),
                                        (305.0, 60.0, RETURN_S + 1, False)):  # fmt: skip
        subject, rest = watched(
            (HOME, 2.0, 0),
            (Rest(500.0, 210.0, 90.0), away_s, 1),
            (Rest(place, 200.0, apart), 0.0, 2),
        )
        assert (subject.state is SE and rest is not None and rest.x_px == 300.0) == known


STEP_NS = 16_666_667
NEUTRAL, EYES = np.array([4.0, 4.0, 4.0, 4.0]), np.array([1.0, 7.0, 1.0, 7.0])


def run(
    glide: EyeEasing,
    start: int,
    count: int,
    eyes: np.ndarray | None,
    generation: int = 0,
    step_ns: int = STEP_NS,
) -> np.ndarray:
    """The positions shown at count refreshes."""
    target = None if eyes is None else tuple(eyes.tolist())
    return np.array(
        [
            glide.at((start + i) * step_ns, target, tuple(NEUTRAL.tolist()), generation)
            for i in range(count)
        ]
    )


def test_found_held_gone_and_found_again() -> None:
    glide = EyeEasing()
    first = run(glide, 0, 120, EYES)
    np.testing.assert_array_equal(first[0], NEUTRAL)  # from neutral
    np.testing.assert_allclose(first[-1], EYES, atol=1e-4)
    hold = round(HOLD_S / STEP_NS * 1e9) - 1
    np.testing.assert_array_equal(run(glide, 120, hold, None), [first[-1]] * hold)
    away = run(glide, 120 + hold, 1000, None)
    assert np.abs(away[5] - first[-1]).max() < 0.1
    np.testing.assert_allclose(away[-1], NEUTRAL, atol=1e-4)
    shares = ((away - NEUTRAL) / (EYES - NEUTRAL))[:, 0]
    assert np.all(np.diff(shares) <= 1e-12)
    assert 0.65 < shares[round(AWAY_S / STEP_NS * 1e9) + 1] < 0.8, (
        "(1 + 1) / e after the time constant"
    )
    back = run(glide, 1200 + hold, 120, EYES + 1, 1)
    assert np.abs(back[0] - away[-1]).max() < 0.1
    np.testing.assert_allclose(back[-1], EYES + 1, atol=1e-3)
    for i in range(30):  # who is followed is not delayed
        np.testing.assert_allclose(
            run(glide, 1400 + hold + i, 1, EYES + i, 1)[0], EYES + i, atol=1e-3
        )


@given(
    st.lists(
        st.tuples(st.booleans(), st.integers(1, 40), st.floats(-8, 8)), min_size=1, max_size=12
    )
)
@settings(max_examples=80)
def test_never_a_jump_whatever_the_faces_do(spans: list[tuple[bool, int, float]]) -> None:
    """Faces come and go anywhere within 8 views; from refresh to refresh the picture moves by a part of that only."""
    glide, start, shown = EyeEasing(), 0, [NEUTRAL]
    for generation, (face, count, place) in enumerate(spans):
        shown += list(run(glide, start, count, NEUTRAL + place if face else None, generation))
        start += count
    steepest = STEP_NS / 1e9 / BACK_S / np.e  # of (1 + s) exp(-s), at s = 1
    assert np.abs(np.diff(shown, axis=0)).max() <= steepest * 16


@given(st.integers(0, 10**18))
def test_any_step_of_time_is_stable(step_ns: int) -> None:
    glide = EyeEasing()
    for i in range(5):
        out = run(glide, i, 1, None if i % 2 else EYES, step_ns=step_ns)
        assert np.all(out >= np.minimum(EYES, NEUTRAL)) and np.all(out <= np.maximum(EYES, NEUTRAL))
