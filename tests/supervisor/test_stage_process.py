"""Which stages count as hung, and who waits for their end."""

import os
import secrets
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfpipe.config import Config, SessionOptions
from lfpipe.supervisor import stage_process
from lfpipe.supervisor.process_table import SOURCE, Stage, consumers
from lfpipe.supervisor.session_store import SessionMemory
from lfpipe.supervisor.stage_process import ASLEEP_S, BUSY_S, COMPUTING, LOSSLESS_CPU_S, StageProcess, wait_for_end
from lfpipe.transport.clock import MS_NS
from lfpipe.transport.context import StageSpec
from lfpipe.transport.session import Session
from lfpipe.transport.status import ROW, State

STAGE = Stage("render", "tests.faults.odd_stage", lambda options: True, reads=("eyes",), hang_timeout_s=1.0)
LOOPS, SAVED = 77, 78


class Script:
    """A process whose clock and row are as a test wants them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **row: object) -> None:
        self.t_ns, self.on_disk, self.cpu_ns = 10**12, False, 0
        monkeypatch.setattr(stage_process, "now_ns", lambda: self.t_ns)
        monkeypatch.setattr(stage_process, "activity", lambda pid: (self.cpu_ns, self.on_disk))
        self.row = np.zeros((), ROW)
        self.row["state"] = State.RUNNING
        self.row["ready_ns"] = self.row["started_ns"] = self.row["beat_ns"] = self.t_ns
        for name, value in row.items():
            self.row[name] = value
        self.process = StageProcess(STAGE, Session("s"), self.row)
        self.process.process = Any  # type: ignore[assignment]  # one that lives
        self.process.overdue()

    def after(self, seconds: float, beats: bool = False, share: float = 0.0) -> str:
        """Judges ten times a second; the first verdict. share: of the time on a CPU."""
        for _ in range(round(10 * seconds)):
            self.t_ns += 100 * MS_NS
            self.cpu_ns += int(share * 100 * MS_NS)
            if beats:
                self.row["beat_ns"] = self.t_ns
            if why := self.process.overdue():
                return why
        return ""


PHASES = {  # state of the row -> seconds without a beat that are allowed
    "starts": ({"ready_ns": 0, "state": State.STARTING}, STAGE.startup_timeout_s),
    "opens another scene": ({"state": State.STARTING, "busy_with": b"opening the scene"}, STAGE.startup_timeout_s),
    "runs": ({}, STAGE.hang_timeout_s),
    "reads": ({"busy_with": b"reading"}, BUSY_S),
    "saves": ({"busy_with": b"writing", "state": State.STOPPING}, BUSY_S),
}


@pytest.mark.parametrize("phase", PHASES)
def test_each_phase_has_its_time_without_a_beat(phase: str, monkeypatch: pytest.MonkeyPatch) -> None:
    row, limit_s = PHASES[phase]
    script = Script(monkeypatch, **row)
    assert script.after(3 * limit_s, beats=True) == "" and script.after(limit_s) == ""
    why = script.after(1)
    assert f"{limit_s:.0f}" in why and row.get("busy_with", b"").decode() in why  # type: ignore[attr-defined]
    assert Script(monkeypatch, **row).after(limit_s + 1, share=0.01), "a thread that only polls computes nothing"
    slow = Script(monkeypatch, **row)
    assert slow.after(COMPUTING * limit_s, share=0.5) == "" and slow.after(1, share=0.5), "a slow machine is no hang"
    replay = Script(monkeypatch, **row)
    replay.process.lossless = True
    longest_s = max(COMPUTING * limit_s, LOSSLESS_CPU_S / 0.5)
    assert replay.after(longest_s - 1, share=0.5) == "" and replay.after(2, share=0.5), "emulated, an inference takes long"


def test_a_wait_for_a_disk_is_busy_declared_or_not_and_an_end_without_words_is_not_judged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    script = Script(monkeypatch)
    script.on_disk = True
    assert script.after(BUSY_S) == "" and "no beat" in script.after(1)
    assert Script(monkeypatch, state=State.STOPPING).after(1000) == ""


def test_a_judge_that_slept_forgives_once(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script(monkeypatch)
    script.t_ns += int((ASLEEP_S + 10) * 1e9)
    assert script.after(STAGE.hang_timeout_s) == "" and "no beat" in script.after(0.5)


class Bench:
    """Runs odd stages one by one, as a supervisor would."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.session = Session(f"j{secrets.token_hex(4)}")
        self.session.run_dir.mkdir(mode=0o700)
        self.memory = SessionMemory(self.session, Config())
        self.process = StageProcess(STAGE, self.session, self.memory.table.rows["render"])

    def start(self, does: str) -> StageProcess:
        options = SessionOptions(source=does, timeline=str(self.folder))
        self.process.start(StageSpec("render", STAGE.module, self.session, Config(), 1, options, consumers(), (), SOURCE))
        self.until(lambda: self.process.row["seq"] == LOOPS)
        return self.process

    def until(self, condition: Callable[[], object]) -> None:
        limit_s = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < limit_s
            time.sleep(0.02)

    def close(self) -> None:
        if self.process.process is not None:
            self.process.process.kill()
            self.process.process.join()
        del self.process
        self.memory.remove()


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    made = Bench(tmp_path)
    yield made
    made.close()


@pytest.mark.live
def test_who_ends_a_session_waits_for_what_is_being_saved_and_for_nothing_else(bench: Bench) -> None:
    process = bench.start("saves")
    os.kill(int(process.row["pid"]), signal.SIGSTOP)
    bench.until(process.overdue)
    os.kill(int(process.row["pid"]), signal.SIGCONT)
    bench.until(lambda: not process.overdue())
    process.wanted = False
    reports: list[str] = []
    process.signal(signal.SIGTERM)
    wait_for_end([process], reports.append)
    assert process.row["seq"] == SAVED and process.row["state"] == State.FINISHED
    assert reports == ["render: writing what is left; press Ctrl-C again to end it at once"]
    process.wanted = True
    process.row["seq"] = 0
    bench.start("hangs at its end")
    assert process.row["restarts"] == 0, "a stage that begins again after its work was done is not restarted"
    process.signal(signal.SIGTERM)
    wait_for_end([process], reports.append)
    assert not process.alive and process.row["state"] == State.DEAD and len(reports) == 1
