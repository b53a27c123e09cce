"""Detection of hung stages, and waits for their end."""

import errno
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import attrs
import numpy as np
import pytest

from lfpipe.config import SessionOptions
from lfpipe.host import signals
from lfpipe.host.worker import Child, is_stopped
from lfpipe.supervisor import stage_process
from lfpipe.supervisor.metrics import GAP_S
from lfpipe.supervisor.process_table import Stage
from lfpipe.supervisor.stage_process import (
    BUSY_S,
    HANG_S,
    MAX_FAILURES,
    StageProcess,
    StageProcesses,
    wait_for_end,
)
from lfpipe.transport.control import Session
from lfpipe.transport.ring import MS_NS, SECOND_NS
from lfpipe.transport.status import ROW, State
from tests.support.refusal import refusal
from tests.support.world import until

STAGE = Stage(
    name="render",
    module="lfpipe.render.stage",
    needed=lambda options: True,
    reads=("eyes",),
)


class Script:
    """A process whose clock and row are as a test wants them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **row: object) -> None:
        self.t_ns = 10**12
        self.stopped = False
        monkeypatch.setattr(stage_process, "now_ns", lambda: self.t_ns)
        monkeypatch.setattr(stage_process, "is_stopped", lambda pid: self.stopped)
        self.row = np.zeros((), ROW)
        self.row["state"] = State.RUNNING
        self.row["ready_ns"] = self.row["started_ns"] = self.row["beat_ns"] = self.t_ns
        for name, value in row.items():
            self.row[name] = value
        self.process = StageProcess(STAGE, Session("s"), self.row)
        self.process.process = Any  # type: ignore[assignment]  # one that lives
        self.process.hang_reason()

    def after(self, seconds: float, beats: bool = False) -> str:
        """Judges ten times a second; the first verdict."""
        for _ in range(round(10 * seconds)):
            self.t_ns += 100 * MS_NS
            if beats:
                self.row["beat_ns"] = self.t_ns
            if why := self.process.hang_reason():
                return why
        return ""


PHASES: dict[
    str, tuple[dict[str, Any], float]
] = {  # state of the row -> seconds without a beat that are allowed
    "starts": ({"ready_ns": 0, "state": State.STARTING}, BUSY_S),
    "opens another scene": (
        {"state": State.STARTING, "busy_with": b"opening the scene"},
        BUSY_S,
    ),
    "runs": ({}, HANG_S),
    "reads": ({"busy_with": b"reading"}, BUSY_S),
    "saves": ({"busy_with": b"writing", "state": State.STOPPING}, BUSY_S),
}


@pytest.mark.parametrize("phase", PHASES)
def test_hang_reason_gives_each_phase_its_time(phase: str, monkeypatch: pytest.MonkeyPatch) -> None:
    row, limit_s = PHASES[phase]
    script = Script(monkeypatch, **row)
    assert script.after(3 * limit_s, beats=True) == "" and script.after(limit_s) == ""
    why = script.after(1)
    assert f"{limit_s:.0f}" in why and row.get("busy_with", b"").decode() in why
    replay = Script(monkeypatch, **row)
    replay.process.lossless = True
    assert replay.after(BUSY_S) == "" and replay.after(1)
    monkeypatch.setattr(stage_process, "PATIENCE", 8.0)
    slow = Script(monkeypatch, **row)
    assert slow.after(8 * limit_s) == "" and slow.after(8), "emulated, an inference takes long"


def test_hang_reason_leaves_a_stage_that_ends_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Script(monkeypatch, state=State.STOPPING).after(1000) == ""


def test_hang_reason_gives_a_stopped_stage_no_time_for_its_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    script = Script(monkeypatch, busy_with=b"waiting for the screen")
    assert script.after(BUSY_S / 2) == ""
    script.stopped = True
    assert "waiting for the screen: no beat" in script.after(0.1)


def test_is_stopped_tells_a_stopped_process() -> None:
    child = Child([sys.executable, "-c", "while True: pass"])
    try:
        assert not is_stopped(child.pid)
        child.send_signal(signal.SIGSTOP)
        until(lambda: is_stopped(child.pid), "stop, once it has a core")
    finally:
        child.close()


def test_hang_reason_forgives_once_after_a_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script(monkeypatch)
    script.t_ns += int((GAP_S + 10) * 1e9)
    assert script.after(HANG_S) == "" and "no beat" in script.after(0.5)


class Ending:
    """A process that has been asked to stop, on a scripted clock. save_s: for so long it writes
    results; then it ends or, if it hangs, waits for SIGKILL.
    """

    def __init__(self, clock: list[int], save_s: float, hangs: bool) -> None:
        self.stage = STAGE
        self.signals = list[int]()
        self._clock = clock
        self._hangs = hangs
        self._saved_ns = clock[0] + int(save_s * 1e9)

    @property
    def alive(self) -> bool:
        return signals.KILL not in self.signals if self._hangs else self._clock[0] < self._saved_ns

    @property
    def saving_description(self) -> str:
        return "writing what is left" if self._clock[0] < self._saved_ns else ""

    def reap(self) -> None: ...

    def signal(self, signum: int) -> None:
        self.signals.append(signum)


def test_wait_for_end_waits_for_what_is_being_saved_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = [10**12]
    reports = list[str]()

    def sleep(seconds: float) -> None:
        clock[0] += int(seconds * 1e9)

    monkeypatch.setattr(stage_process, "now_ns", lambda: clock[0])
    monkeypatch.setattr(stage_process, "time", SimpleNamespace(sleep=sleep))
    saving, hung = Ending(clock, 20, False), Ending(clock, 0, True)
    wait_for_end([saving], reports.append)  # type: ignore[list-item]
    assert not saving.signals and clock[0] >= 10**12 + 20 * 10**9
    assert reports == ["render: writing what is left; press Ctrl-C again to end it at once"]
    wait_for_end([hung], reports.append)  # type: ignore[list-item]
    assert hung.signals == [signals.END, signals.KILL] and len(reports) == 1


def test_failed_again_starts_later_each_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    script = Script(monkeypatch)
    process = script.process
    delays_s = []
    for _ in range(8):
        process.failed()
        delays_s.append((process.next_start_ns - script.t_ns) / 1e9)
        script.t_ns = process.next_start_ns
    assert delays_s == [0.1, 0.2, 0.4, 0.8, 1.6, 1.6, 1.6, 1.6], "five failures are remembered"
    script.t_ns += 60 * 10**9
    process.failed()
    assert process.next_start_ns - script.t_ns == 10**8


def test_a_stage_that_cannot_be_started_is_tried_again_and_then_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It ended the session with a traceback."""
    monkeypatch.setenv("LFPIPE_RUN_DIR", str(tmp_path))
    t_ns = [10**12]
    monkeypatch.setattr(stage_process, "now_ns", lambda: t_ns[0])
    child = Mock(side_effect=OSError(errno.EAGAIN, "Resource temporarily unavailable"))
    monkeypatch.setattr(stage_process, "Child", child)
    monkeypatch.setattr(stage_process, "STAGES", (STAGE,))
    table: Any = SimpleNamespace(rows={"render": np.zeros((), ROW)})
    spec: Any = SimpleNamespace(
        options=SimpleNamespace(viewer=SimpleNamespace(source=""), clock=None), name="render"
    )
    monkeypatch.setattr("lfpipe.supervisor.child.start_line", lambda spec: b"")
    told: list[str] = []
    stages = StageProcesses(Session("s"), table, lambda stage: spec, Mock(), told.append)
    options = SessionOptions()
    for attempts in range(1, MAX_FAILURES):
        stages.ensure_running(options)
        stages.ensure_running(options)  # not before its time
        assert child.call_count == len(told) == attempts and "trying again" in told[-1]
        t_ns[0] += 3 * SECOND_NS
    error = refusal(stages.ensure_running, options)
    assert "render cannot be started: Resource temporarily" in str(error) and error.remedy


@pytest.mark.parametrize("code", [0, 143])
def test_a_stage_that_was_asked_to_stop_and_is_needed_again_has_not_failed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, code: int
) -> None:
    """A viewer that came back before its tracker had ended was rolled back."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    children = [Mock(**{"poll.return_value": None}, pid=pid) for pid in (1, 2)]
    monkeypatch.setattr(stage_process, "Child", Mock(side_effect=children))
    monkeypatch.setattr("lfpipe.supervisor.child.start_line", lambda spec: b"")
    needed = [True]
    stage = attrs.evolve(STAGE, needed=lambda options: needed[0])
    monkeypatch.setattr(stage_process, "STAGES", (stage,))
    table: Any = SimpleNamespace(rows={"render": np.zeros((), ROW)})
    spec: Any = SimpleNamespace(options=SessionOptions(), name="render")
    stages = StageProcesses(Session("s"), table, lambda stage: spec, Mock(), Mock())
    for wanted in (True, False, True):
        needed[0] = wanted
        stages.ensure_running(SessionOptions())
    children[0].poll.return_value = code
    table.rows["render"]["taken_seq"] = 7
    assert stages.check() == []
    # one whose work was done leaves nothing that its successor would count as lost
    assert table.rows["render"]["taken_seq"].any() == (code != 0)
    stages.ensure_running(SessionOptions())
    assert [one.process for one in stages] == [children[1]]
