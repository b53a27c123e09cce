"""Sums have the same bits under every Python."""

from hypothesis import given
from hypothesis import strategies as st

from lfpipe.host.addition import add


def test_what_rounding_loses_is_lost() -> None:
    assert add([1e16, 1.0, -1e16]) == 0.0  # `sum` gives 1.0 from Python 3.12 on, 0.0 before
    assert add([]) == 0.0


@given(st.lists(st.integers(-(2**40), 2**40), max_size=9))
def test_sums_of_whole_numbers_are_exact(values: list[int]) -> None:
    assert add(map(float, values)) == sum(values)
