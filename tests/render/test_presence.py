"""The viewer's states, by their transitions."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from lfpipe.render.presence import ABSENT_S, GAP_S, REST_S, REST_SPAN, RETURN_S, Presence, Rest, ViewerState

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
        before, rest = self.subject.state, self.subject.update(self.t_ns, here, self.generation, beyond)
        after = self.subject.state
        assert after in ALLOWED[before], f"{before.word} to {after.word}"
        if rest is not None:
            assert after is SE and here is not None
            assert before in (A, E, L) or beyond or self.exchanged, "a seated viewer is measured anew beyond the grid alone"
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
        assert self.subject.state is (E if back is None else SE), "another face, or the one that sat there"
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
        found = [self.frame(Rest(self.x, 200.0, 60.0), beyond=True) for _ in range(int(seconds * 30))]
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
        subject, rest = watched((HOME, 2.0, 0), (Rest(500.0, 210.0, 90.0), away_s, 1), (Rest(place, 200.0, apart), 0.0, 2))
        assert (subject.state is SE and rest is not None and rest.x_px == 300.0) == known
