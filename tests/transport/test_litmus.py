"""The ring's fences on a machine that reorders: with all of them nothing is torn, and none can be left out."""

import pytest

from tests.transport import litmus


def test_every_execution_gives_whole_slots() -> None:
    assert litmus.verdict() == "whole"


@pytest.mark.parametrize("name", litmus.FENCES)
def test_no_fence_can_be_left_out(name: str) -> None:
    assert litmus.verdict(name) != "whole"


def test_the_model_knows_every_fence_of_the_ring() -> None:
    programs = [litmus.writer_program(""), *(litmus.reader_program("", way, 0, 1)[0] for way in litmus.WAYS)]
    fences = [sum(access.place is None for access in program) for program in programs]
    assert fences == [2 * litmus.PUBLISHED, 2, 2, 3]
