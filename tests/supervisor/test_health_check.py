"""Which stages count as hung: real processes that compute, sleep, starve, stop or wait for a file."""

import os
import secrets
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from lfpipe.config import Config, SessionOptions
from lfpipe.host.processes import activity
from lfpipe.supervisor import health_check
from lfpipe.supervisor.health_check import HealthCheck
from lfpipe.supervisor.process_table import SOURCE, Stage, consumers
from lfpipe.supervisor.session_memory import SessionMemory
from lfpipe.supervisor.stage_process import StageProcess
from lfpipe.supervisor.stage_processes import wait_for_end
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.session import Session
from lfpipe.transport.stage_spec import StageSpec
from lfpipe.transport.status import ROW, State, busy_words
from tests.faults.odd_stage import FIFO

STAGE = Stage(
    "render", "tests.faults.odd_stage", lambda options: True, reads=("eyes",), startup_timeout_s=1.5, hang_timeout_s=1.0
)
CAME_THROUGH, SAVED = 77, 78


class Bench:
    """Runs odd stages one by one, as a supervisor would."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.session = Session(f"j{secrets.token_hex(4)}")
        self.session.run_dir.mkdir(mode=0o700)
        self.memory = SessionMemory(self.session, Config())
        self.process = StageProcess(STAGE, self.session, self.memory.table.rows["render"])
        os.mkfifo(folder / FIFO)

    def start(self, does: str, for_s: float = 0.0) -> StageProcess:
        options = SessionOptions(source=does, source_hz=for_s, still=str(self.folder))
        spec = StageSpec("render", STAGE.module, self.session, Config(), 1, options, consumers(), (), SOURCE)
        self.process.start(spec)
        return self.process

    def until(self, condition: Callable[[], bool], timeout_s: float = 40) -> str:
        """Judges until condition holds: nothing, or why the process counted as hung before."""
        limit = time.monotonic() + timeout_s
        while not condition():
            if why := self.process.overdue():
                return why
            assert time.monotonic() < limit, "neither hung nor done"
            assert self.process.reap() is None
            time.sleep(0.02)
        return ""

    def came_through(self) -> bool:
        return int(self.process.row["seq"]) == CAME_THROUGH

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
@pytest.mark.parametrize("does", ["is stopped before it is ready", "sleeps before it is ready"])
def test_a_stage_that_does_nothing_before_it_is_ready_is_hung(bench: Bench, does: str) -> None:
    bench.start(does)
    assert "not ready" in bench.until(bench.came_through)


@pytest.mark.live
@pytest.mark.parametrize("does", ["computes before it is ready", "computes for another scene"])
def test_a_stage_that_computes_for_longer_than_a_start_may_take_is_not_hung(bench: Bench, does: str) -> None:
    bench.start(does, for_s=2 * STAGE.startup_timeout_s)
    assert bench.until(bench.came_through) == ""


@pytest.mark.live
@pytest.mark.parametrize("does", ["is stopped", "waits for a file and says nothing"])
def test_a_stage_without_a_beat_is_hung(bench: Bench, does: str) -> None:
    bench.start(does)
    assert "no beat for" in bench.until(bench.came_through)


@pytest.mark.live
def test_a_stage_that_says_it_waits_for_a_file_is_not_hung_and_the_row_says_so(bench: Bench) -> None:
    process = bench.start("waits for a file")
    assert bench.until(lambda: busy_words(process.row) == "reading a slow file") == ""
    begin_ns = now_ns()
    assert bench.until(lambda: now_ns() - begin_ns > 3 * STAGE.hang_timeout_s * 1e9) == ""
    assert process.row["busy_since_ns"] <= begin_ns
    (bench.folder / FIFO).write_bytes(b"at last")
    assert bench.until(bench.came_through) == "" and busy_words(process.row) == ""


@pytest.mark.live
def test_who_ends_a_session_waits_for_what_is_being_saved_and_for_nothing_else(bench: Bench) -> None:
    process = bench.start("saves", for_s=3.0)  # more than a stage may take for its end
    assert bench.until(bench.came_through) == ""
    process.wanted = False
    told: list[str] = []
    _stop(process)
    wait_for_end([process], told.append)
    assert process.row["seq"] == SAVED and process.row["state"] == State.FINISHED
    assert told == ["render: writing what is left; press Ctrl-C again to end it at once"]
    process.wanted = True
    bench.start("hangs at its end")
    assert process.row["restarts"] == 0, "a stage that begins again after its work was done is not restarted"
    process.row["seq"] = 0
    assert bench.until(bench.came_through) == ""
    _stop(process)
    wait_for_end([process], told.append)
    assert not process.alive and process.row["state"] == State.DEAD and len(told) == 1


def _stop(process: StageProcess) -> None:
    os.kill(int(process.row["pid"]), 15)


class Script:
    """Time and activity as a test wants them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **row: object) -> None:
        self.t_ns = 10**12
        monkeypatch.setattr(health_check, "now_ns", lambda: self.t_ns)
        self.row = np.zeros((), ROW)
        self.row["state"] = State.RUNNING
        self.row["ready_ns"] = self.row["started_ns"] = self.row["beat_ns"] = self.t_ns
        for name, value in row.items():
            self.row[name] = value
        self.cpu_ns, self.on_disk = 0, False
        self.judge = HealthCheck(STAGE, self.row, 1, lambda pid: (self.cpu_ns, self.on_disk))

    def after(self, seconds: float, share: float = 0.0, beats: bool = False) -> str:
        """Judges ten times a second; the first verdict. share: of the time on a CPU."""
        for _ in range(round(10 * seconds)):
            self.t_ns += 100 * MS_NS
            self.cpu_ns += int(share * 100 * MS_NS)
            if beats:
                self.row["beat_ns"] = self.t_ns
            if why := self.judge.problem():
                return why
        return ""


PHASES = {  # state of the row -> seconds without any work, and without a beat, that are allowed
    "starts": ({"ready_ns": 0, "state": State.STARTING}, STAGE.startup_timeout_s, health_check.LONGEST_S),
    "opens another scene": ({"state": State.STARTING}, STAGE.startup_timeout_s, health_check.LONGEST_S),
    "runs": ({}, STAGE.hang_timeout_s, health_check.COMPUTING * STAGE.hang_timeout_s),
    "reads": ({"busy_with": b"reading"}, health_check.STALL_S, health_check.LONGEST_S),
    "saves": ({"busy_with": b"writing", "state": State.STOPPING}, health_check.STALL_S, health_check.LONGEST_S),
}


@pytest.mark.parametrize("phase", PHASES)
def test_a_phase_has_a_limit_of_idling_and_one_of_computing(phase: str, monkeypatch: pytest.MonkeyPatch) -> None:
    row, idle_s, longest_s = PHASES[phase]
    script = Script(monkeypatch, **row)
    assert script.after(idle_s) == "" and "idle" in script.after(1)
    script = Script(monkeypatch, **row)
    assert script.after(longest_s, share=0.5) == "" and f"{longest_s:.0f}" in script.after(1, share=0.5)
    script = Script(monkeypatch, **row)
    assert script.after(longest_s - 1, share=2 * health_check.WORKS_SHARE) == "", "a slow machine is no hang"
    assert script.after(2 * longest_s, beats=True) == ""


def test_a_thread_that_only_polls_is_no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "no beat" in Script(monkeypatch).after(STAGE.hang_timeout_s + 1, share=0.5 * health_check.WORKS_SHARE)


def test_the_kernels_wait_for_a_disk_has_a_minute_declared_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script(monkeypatch)
    script.on_disk = True
    assert script.after(health_check.STALL_S) == "" and "no beat" in script.after(1)


def test_an_end_without_words_is_not_judged_here(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Script(monkeypatch, state=State.STOPPING).after(1000) == ""


def test_activity_is_that_of_the_process() -> None:
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        before_ns, _ = activity(process.pid)
        end_s = time.monotonic() + 30
        while activity(process.pid)[0] < before_ns + 50 * MS_NS:
            assert time.monotonic() < end_s
            time.sleep(0.02)
        assert activity(process.pid)[1] is False
    finally:
        process.kill()
        process.wait()
    assert activity(process.pid) == (0, False)
