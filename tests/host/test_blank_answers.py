"""`BlankAnswers`: which picture each blank of an X server showed."""

from lfpipe.host.presentation import BlankAnswers, Presented
from lfpipe.transport.clock import MS_NS

PERIOD_NS = 16 * MS_NS


def started() -> BlankAnswers:
    """After two pictures: the period is known."""
    answers = BlankAnswers()
    for number in (1, 2):
        answers.asked(number, number * PERIOD_NS - 8 * MS_NS)
        answers.answered(number, number * PERIOD_NS, number)
        answers.rest()
    return answers


def test_the_last_of_two_pictures_before_one_blank_was_shown() -> None:
    answers = started()
    answers.asked(3, 3 * PERIOD_NS - 8 * MS_NS)
    answers.asked(4, 3 * PERIOD_NS - 2 * MS_NS)
    assert answers.answered(3, 3 * PERIOD_NS, 3) == []
    assert answers.answered(4, 3 * PERIOD_NS, 3) == [Presented(3, 0, 0)]
    assert answers.rest() == [Presented(4, 3 * PERIOD_NS, PERIOD_NS)]


def test_an_answer_that_was_put_off_by_a_blank_is_that_of_its_own_blank() -> None:
    answers = started()
    answers.asked(3, 3 * PERIOD_NS - 8 * MS_NS)
    answers.asked(4, 4 * PERIOD_NS - 8 * MS_NS)
    assert answers.answered(4, 4 * PERIOD_NS, 4) == []
    assert answers.answered(3, 4 * PERIOD_NS + MS_NS, 4) == [
        Presented(3, 3 * PERIOD_NS + MS_NS, PERIOD_NS)
    ]
    assert answers.rest() == [Presented(4, 4 * PERIOD_NS, PERIOD_NS)]


def test_an_answer_is_held_while_another_may_follow() -> None:
    answers = started()
    answers.asked(3, 3 * PERIOD_NS - 8 * MS_NS)
    answers.asked(4, 4 * PERIOD_NS - 8 * MS_NS)
    answers.answered(3, 3 * PERIOD_NS, 3)
    assert answers.rest() == []
    assert answers.answered(4, 4 * PERIOD_NS, 4) == [Presented(3, 3 * PERIOD_NS, PERIOD_NS)]
    assert answers.rest() == [Presented(4, 4 * PERIOD_NS, PERIOD_NS)]
