"""`VblankAnswers`: the picture shown at each vblank of an X server."""

import pytest

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
