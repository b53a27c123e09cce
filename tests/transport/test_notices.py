"""Notices of a session, from rows of the status table."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.transport import notices as module
from lfpipe.transport.notices import FACELESS_NS, FAULT_NS, faults, notices
from lfpipe.transport.status import ROW, Row, State

T_NS = 10**12


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> dict[str, NDArray[np.void]]:
    monkeypatch.setattr(module, "now_ns", lambda: T_NS)
    made = {name: np.zeros((), ROW) for name in ("capture", "track", "render")}
    for row in made.values():
        row["state"] = State.RUNNING
    made["render"]["t_face_ns"] = T_NS - FACELESS_NS
    return made


def told(rows: dict[str, NDArray[np.void]]) -> list[str]:
    return notices(rows, "capture", "render")


def test_notices_tell_a_missing_face_while_all_run(
    rows: dict[str, NDArray[np.void]],
) -> None:
    assert told(rows) == []
    rows["render"]["t_face_ns"] -= 1
    assert told(rows) == ["no face for 4 s: move into the camera's view"]
    rows["capture"]["state"] = State.READY
    assert told(rows) == ["camera lost, trying again"]
    rows["capture"]["state"] = State.NONE
    assert told(rows) == [], "the mouse is the viewer"


def test_notices_tell_a_fault_instead_of_a_missing_face(
    rows: dict[str, NDArray[np.void]],
) -> None:
    rows["render"]["t_face_ns"] -= 1
    rows["track"]["fault"] = b"the filter is broken"
    rows["track"]["fault_since_ns"] = T_NS - FAULT_NS
    assert list(faults(rows, T_NS)) == [], "a few frames"
    assert list(faults(rows, T_NS + 1)) == [("the filter is broken", False)]
    rows["track"]["spoilt"] = rows["track"]["worked"] = 30
    rows["track"]["fault_since_ns"] -= 1
    assert list(faults(rows, T_NS)) == [("the filter is broken", True)]
    assert told(rows) == ["the filter is broken: the picture does not follow you"]


def test_judge_keeps_the_time_of_the_first_fault() -> None:
    row = Row(np.zeros((), ROW))
    row.judge("", True)
    assert (row["fault_since_ns"], row["worked"], row["spoilt"]) == (0, 1, 0)
    row.judge("broken", False)
    since_ns = row["fault_since_ns"]
    row.judge("broken", False)
    assert row["fault_since_ns"] == since_ns > 0 and row["spoilt"] == 2
    row.judge("", False)
    assert not row.record["fault"].item() and row["worked"] == 1, "nobody there proves nothing"
