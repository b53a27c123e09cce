"""Pictures on their way to the light are reported once each, in their order, by their blank or by their hand-over."""

from lfpipe.host.presentation import Presented
from lfpipe.render.shown_pictures import ANSWER_NS, HANDOVER, REPLACED, ShownPictures


class Log:
    def __init__(self) -> None:
        self.shown = ShownPictures()
        self.lines: list[tuple[str, int, str]] = []

    def add(self, name: str, number: int, t_ns: int) -> None:
        self.shown.add(number, t_ns, lambda t, by: self.lines.append((name, t, by)))

    def stays(self, name: str, t_ns: int) -> None:
        self.shown.stays(t_ns, "blanks", lambda t, by: self.lines.append((name, t, by)))


def test_a_picture_waits_for_its_blank_and_those_behind_it_wait_too() -> None:
    log = Log()
    log.add("a", 1, 100)
    log.stays("b", 200)
    log.add("c", 2, 300)
    log.shown.take([Presented(2, 350, 0)], "blanks", 360)
    assert log.lines == []
    log.shown.take([Presented(1, 150, 0)], "blanks", 370)
    assert log.lines == [("a", 150, "blanks"), ("b", 200, "blanks"), ("c", 350, "blanks")]
    log.shown.take([Presented(1, 999, 0), Presented(7, 1, 0)], "blanks", 380)
    assert len(log.lines) == 3, "an answer twice, and one to nothing"


def test_one_that_was_replaced_has_no_time_and_one_never_answered_its_hand_over() -> None:
    log = Log()
    log.add("replaced", 1, 100)
    log.add("unanswered", 2, 200)
    log.shown.take([Presented(1, 0, 0)], "blanks", 300)
    assert log.lines == [("replaced", 0, REPLACED)]
    log.shown.take([], "blanks", 200 + ANSWER_NS + 1)
    log.add("at the end", 3, 10**9)
    log.shown.flush()
    assert log.lines[1:] == [("unanswered", 200, HANDOVER), ("at the end", 10**9, HANDOVER)]
