"""Targets on the command line: accepted in one exact form, or refused before anything starts
(`messages.py`); nothing is sent.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.extras.share.target import check_target, parse_target


@pytest.mark.parametrize(
    ("text", "exact"),
    [
        ("opentrack:localhost:4242?rate=120", "opentrack:127.0.0.1:4242?rate=120"),
        ("osc:[::1]:9000", "osc:[::1]:9000"),
        ("lsl", "lsl:lfpipe"),
        ("lsl:eye lab?rate=59.94", "lsl:eye lab?rate=59.94"),
    ],
)
def test_a_target_has_one_exact_form(text: str, exact: str) -> None:
    assert str(check_target(text)) == str(parse_target(exact)) == exact


@given(
    st.text(max_size=40)
    | st.from_regex(r"(osc|opentrack|lsl):.{0,20}:?[0-9]{0,7}(\?rate=.{0,6})?", fullmatch=True)
)
def test_any_text_is_accepted_in_its_exact_form_or_refused(text: str) -> None:
    try:
        target = parse_target(text)
    except UserError as error:
        assert error.remedy
    else:
        assert parse_target(str(target)) == target
