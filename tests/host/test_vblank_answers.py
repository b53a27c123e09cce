"""`VblankAnswers`: the picture shown at each vblank of an X server."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from lfpipe.host.presentation import Presented, VblankAnswers
from lfpipe.transport.ring import MS_NS

PERIOD_NS = 16 * MS_NS


@given(
    st.lists(
        st.tuples(
            st.integers(MS_NS, 3 * PERIOD_NS),  # since the picture before it
            st.sampled_from((0, 0, PERIOD_NS)),  # its answer is late by
        ),
        max_size=60,
    )
)
def test_the_last_picture_before_a_vblank_is_shown_then(pictures: list[tuple[int, int]]) -> None:
    answers, reports, events = VblankAnswers(), list[Presented](), list[tuple[int, int, bool]]()
    pictures = [(PERIOD_NS + 1, 0)] * 2 + pictures  # after two the period is known
    submitted_ns = [*itertools.accumulate(gap_ns for gap_ns, _ in pictures)]
    vblanks_ns = [(t_ns // PERIOD_NS + 1) * PERIOD_NS for t_ns in submitted_ns]
    for serial, (_, late_ns) in enumerate(pictures):
        events += [
            (submitted_ns[serial], serial, False),
            (vblanks_ns[serial] + late_ns, serial, True),
        ]
    for t_ns, serial, is_answer in sorted(events):
        if is_answer:
            reports += [*answers.on_answer(serial, t_ns, t_ns // PERIOD_NS), *answers.last_answer()]
        else:
            answers.on_submission(serial, t_ns)
    assert [(report.serial, report.t_ns) for report in reports] == [
        (serial, 0 if t_ns == next_ns else t_ns)
        for serial, (t_ns, next_ns) in enumerate(itertools.pairwise([*vblanks_ns, 0]))
    ]
