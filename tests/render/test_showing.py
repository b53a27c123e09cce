"""Pictures on their way to the light are known once each, in their order, by their blank or by their hand-over."""

from collections import deque

from lfpipe.host.presentation import Presented
from lfpipe.render.showing import ANSWER_NS, HANDOVER, REPLACED, Showing, take_known
from lfpipe.render.viewer import Viewpoints

NOWHERE = Viewpoints((0.0, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 0)


def showing(number: int, t_ns: int, by: str = "") -> Showing:
    return Showing(number, None, None, NOWHERE, 0, t_ns, 0, 0, 0, 0, 0, t_ns, 0, 0, t_ns if by else 0, by)


def known(waiting: deque[Showing], answers: list[Presented], t_ns: int) -> list[tuple[int, int, str]]:
    return [(one.t_handed_ns, one.t_presented_ns, one.by) for one in take_known(waiting, answers, "blanks", t_ns)]


def test_a_picture_waits_for_its_blank_and_those_behind_it_wait_too() -> None:
    waiting = deque((showing(1, 100), showing(0, 200, "blanks"), showing(2, 300)))
    assert known(waiting, [Presented(2, 350, 0)], 360) == []
    assert known(waiting, [Presented(1, 150, 0)], 370) == [(100, 150, "blanks"), (200, 200, "blanks"), (300, 350, "blanks")]
    assert known(waiting, [Presented(1, 999, 0), Presented(7, 1, 0)], 380) == [], "an answer twice, and one to nothing"


def test_one_that_was_replaced_has_no_time_and_one_never_answered_its_hand_over() -> None:
    waiting = deque((showing(1, 100), showing(2, 200)))
    assert known(waiting, [Presented(1, 0, 0)], 300) == [(100, 0, REPLACED)]
    assert known(waiting, [], 200 + ANSWER_NS + 1) == [(200, 200, HANDOVER)]
