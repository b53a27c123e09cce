"""`VblankAnswers`: the picture shown at each vblank of an X server."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.host.presentation import Presented, VblankAnswers
from lfpipe.transport.ring import MS_NS

PERIOD_NS = 16 * MS_NS
THIRD, FOURTH = 3 * PERIOD_NS, 4 * PERIOD_NS  # the times of vblanks
LAST = (None, [Presented(4, FOURTH, PERIOD_NS)])
Step = tuple[tuple[int, int, int] | None, list[Presented]]
# when pictures 3 and 4 were asked for; then answers (None: a rest), and what they say was shown
PLAYS: dict[str, tuple[tuple[int, int], list[Step]]] = {
    "the last of two before one vblank was shown": (
        (THIRD - 8 * MS_NS, THIRD - 2 * MS_NS),
        [
            ((3, THIRD, 3), []),
            ((4, THIRD, 3), [Presented(3, 0, 0)]),
            (None, [Presented(4, THIRD, PERIOD_NS)]),
        ],
    ),
    "a delayed answer belongs to its own vblank": (
        (THIRD - 8 * MS_NS, FOURTH - 8 * MS_NS),
        [
            ((4, FOURTH, 4), []),
            ((3, FOURTH + MS_NS, 4), [Presented(3, THIRD + MS_NS, PERIOD_NS)]),
            LAST,
        ],
    ),
    "one is held while another may follow": (
        (THIRD - 8 * MS_NS, FOURTH - 8 * MS_NS),
        [
            ((3, THIRD, 3), []),
            (None, []),
            ((4, FOURTH, 4), [Presented(3, THIRD, PERIOD_NS)]),
            LAST,
        ],
    ),
}


@pytest.mark.parametrize("name", PLAYS)
def test_vblank_answers(name: str) -> None:
    answers = VblankAnswers()
    for number in (1, 2):  # then the period is known
        answers.on_submission(number, number * PERIOD_NS - 8 * MS_NS)
        answers.on_answer(number, number * PERIOD_NS, number)
        answers.last_answer()
    asked_ns, steps = PLAYS[name]
    for number, t_ns in enumerate(asked_ns, 3):
        answers.on_submission(number, t_ns)
    for step, shown in steps:
        assert (answers.on_answer(*step) if step else answers.last_answer()) == shown


@given(
    st.lists(
        st.tuples(
            st.integers(MS_NS, 3 * PERIOD_NS),  # since the picture before it
            st.sampled_from((0, 0, 0, PERIOD_NS // 3, PERIOD_NS)),  # its answer is late by
        ),
        min_size=3,
        max_size=60,
    )
)
def test_each_picture_is_reported_once_and_in_order(pictures: list[tuple[int, int]]) -> None:
    answers, reports, events = VblankAnswers(), list[Presented](), list[tuple[int, int, bool]]()
    for serial, t_ns in enumerate(itertools.accumulate(gap_ns for gap_ns, _ in pictures)):
        answer_ns = (t_ns // PERIOD_NS + 1) * PERIOD_NS + pictures[serial][1]
        events += [(t_ns, serial, False), (answer_ns, serial, True)]
    for t_ns, serial, is_answer in sorted(events):
        if is_answer:
            reports += [*answers.on_answer(serial, t_ns, t_ns // PERIOD_NS), *answers.last_answer()]
        else:
            answers.on_submission(serial, t_ns)
    assert [report.serial for report in reports] == [*range(len(pictures))]
    shown_ns = [report.t_ns for report in reports if report.t_ns]
    assert shown_ns == sorted(set(shown_ns)), "one picture at a vblank"
