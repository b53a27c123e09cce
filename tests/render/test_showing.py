"""Pictures on their way to the light are known once each, in their order, by their blank or by their hand-over."""

from lfpipe.host.presentation import Presented
from lfpipe.render.showing import ANSWER_NS, HANDOVER, REPLACED, Showing, WaitingPictures
from lfpipe.render.viewer import Viewpoints

NOWHERE = Viewpoints((0.0, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 0)


class Log:
    def __init__(self) -> None:
        self.waiting = WaitingPictures()
        self.names: dict[int, str] = {}

    def add(self, name: str, number: int, t_ns: int, by: str = "") -> None:
        showing = Showing(number, None, None, NOWHERE, 0, t_ns, 0, 0, 0, 0, 0, t_ns, 0, 0, {}, t_ns if by else 0, by)
        self.names[id(showing)] = name
        self.waiting.add(showing)

    def take(self, answers: list[Presented], t_ns: int) -> list[tuple[str, int, str]]:
        known = self.waiting.take(answers, "blanks", t_ns)
        return [(self.names[id(each)], each.t_presented_ns, each.by) for each in known]


def test_a_picture_waits_for_its_blank_and_those_behind_it_wait_too() -> None:
    log = Log()
    log.add("a", 1, 100)
    log.add("b", 0, 200, "blanks")
    log.add("c", 2, 300)
    assert log.take([Presented(2, 350, 0)], 360) == []
    assert log.take([Presented(1, 150, 0)], 370) == [("a", 150, "blanks"), ("b", 200, "blanks"), ("c", 350, "blanks")]
    assert log.take([Presented(1, 999, 0), Presented(7, 1, 0)], 380) == [], "an answer twice, and one to nothing"


def test_one_that_was_replaced_has_no_time_and_one_never_answered_its_hand_over() -> None:
    log = Log()
    log.add("replaced", 1, 100)
    log.add("unanswered", 2, 200)
    assert log.take([Presented(1, 0, 0)], 300) == [("replaced", 0, REPLACED)]
    assert log.take([], 200 + ANSWER_NS + 1) == [("unanswered", 200, HANDOVER)]
