"""Notices of a session's condition: the most urgent one."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.notices import (
    FACELESS_NS,
    FAULT_NS,
    Fault,
    Notice,
    faults,
    notices,
)
from lfpipe.transport.status import ROW, State

T_NS = 10**12
Rows = dict[str, NDArray[np.void]]


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> Rows:
    monkeypatch.setattr("lfpipe.notices.now_ns", lambda: T_NS)
    made = {name: np.zeros((), ROW) for name in ("capture", "track", "render")}
    for row in made.values():
        row["state"] = State.RUNNING
    return made


def shown(rows: Rows, faceless_ns: int, **flags: bool) -> list[Notice]:
    frames = {"covered": False} | flags
    return notices(rows, "capture", "render", T_NS - faceless_ns, frames)


def test_notices_report_a_missing_face_while_all_stages_run(rows: Rows) -> None:
    assert shown(rows, FACELESS_NS) == []
    (notice,) = shown(rows, FACELESS_NS + 1)
    assert notice.nobody and "4 s" in notice.text
    rows["capture"]["state"] = State.READY
    (notice,) = shown(rows, FACELESS_NS + 1)
    assert not notice.nobody and "camera lost" in notice.text
    rows["capture"]["state"] = State.NONE
    assert shown(rows, FACELESS_NS + 1) == [], "the mouse is the viewer"


def test_notices_report_a_fault_instead_of_a_missing_face(rows: Rows) -> None:
    rows["track"]["fault"] = b"the filter is broken"
    rows["track"]["fault_since_ns"] = T_NS - FAULT_NS
    assert list(faults(rows, T_NS)) == [], "a few frames"
    assert list(faults(rows, T_NS + 1)) == [Fault("the filter is broken", has_worked=False)]
    rows["track"]["outputs_faulty"] = rows["track"]["outputs_ok"] = 30
    rows["track"]["fault_since_ns"] -= 1
    assert list(faults(rows, T_NS)) == [Fault("the filter is broken", has_worked=True)]
    (notice,) = shown(rows, FACELESS_NS + 1)
    assert not notice.nobody and "the filter is broken" in notice.text


def test_notices_report_a_cover_instead_of_a_missing_face(rows: Rows) -> None:
    (cover,) = shown(rows, FACELESS_NS + 1, covered=True)
    assert not cover.nobody and "shutter" in cover.text
