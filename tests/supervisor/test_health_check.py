"""Which stages count as hung: real processes that compute, sleep, starve, stop or wait for a file."""

import os
import secrets
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import attrs
import numpy as np
import psutil
import pytest

from lfpipe.config import Config, SessionOptions
from lfpipe.host import PORTABLE, activity
from lfpipe.host.sample import Sample, Thread
from lfpipe.supervisor import health_check
from lfpipe.supervisor.health_check import HealthCheck
from lfpipe.supervisor.process_table import SOURCE, Stage, consumers
from lfpipe.supervisor.session_memory import SessionMemory
from lfpipe.supervisor.shutdown import wait_for_end
from lfpipe.supervisor.stage_process import StageProcess
from lfpipe.supervisor.time_spent import TimeSpent
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


@pytest.mark.parametrize("does", ["is stopped before it is ready", "sleeps before it is ready"])
def test_a_stage_that_does_nothing_before_it_is_ready_is_hung(bench: Bench, does: str) -> None:
    bench.start(does)
    assert "not ready" in bench.until(bench.came_through)


@pytest.mark.parametrize("does", ["computes before it is ready", "computes for another scene"])
def test_a_stage_that_computes_for_longer_than_a_start_may_take_is_not_hung(bench: Bench, does: str) -> None:
    bench.start(does, for_s=2 * STAGE.startup_timeout_s)
    assert bench.until(bench.came_through) == ""


@pytest.mark.parametrize("does", ["spins", "is stopped", "waits for a file and says nothing"])
def test_a_stage_without_a_beat_is_hung(bench: Bench, does: str) -> None:
    bench.start(does)
    assert "no beat for" in bench.until(bench.came_through)


def test_a_stage_that_says_it_waits_for_a_file_is_not_hung_and_the_row_says_so(bench: Bench) -> None:
    process = bench.start("waits for a file")
    assert bench.until(lambda: busy_words(process.row) == "reading a slow file") == ""
    begin_ns = now_ns()
    assert bench.until(lambda: now_ns() - begin_ns > 3 * STAGE.hang_timeout_s * 1e9) == ""
    assert process.row["busy_since_ns"] <= begin_ns
    (bench.folder / FIFO).write_bytes(b"at last")
    assert bench.until(bench.came_through) == "" and busy_words(process.row) == ""


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


def _watched(command: list[str], seconds: float = 2.0, before: Callable[[int], None] = lambda pid: None) -> TimeSpent:
    """Where the time of a command goes, once it has written a line."""
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None and process.stdout.readline()
    before(process.pid)
    spent, last = TimeSpent(), activity.sample(process.pid)
    assert last is not None
    t_ns = now_ns()
    begin_ns = t_ns
    while t_ns - begin_ns < seconds * 1e9:
        time.sleep(0.1)
        now, before_ns = activity.sample(process.pid), t_ns
        t_ns = now_ns()
        assert now is not None
        spent.add(last, now, t_ns - before_ns)
        last = now
    process.kill()
    process.communicate()
    assert activity.sample(process.pid) is None
    return spent


PYTHON = [sys.executable, "-c"]
SPINS = "print(flush=True)\nwhile True: pass"


def test_computing_is_work_and_sleeping_is_idle() -> None:
    spins, sleeps = _watched([*PYTHON, SPINS]), _watched([*PYTHON, "import time; print(flush=True); time.sleep(60)"])
    assert spins.worked > (0 if PORTABLE else 3 * spins.idle) and spins.able == spins.worked + spins.idle
    assert not sleeps.worked and sleeps.idle == sleeps.able == sleeps.waited == sleeps.unmoved > 0


def test_a_stopped_process_is_stopped() -> None:
    def stopped(pid: int) -> None:
        while psutil.Process(pid).status() != psutil.STATUS_STOPPED:
            time.sleep(0.01)

    spent = _watched([*PYTHON, "import os; print(flush=True); os.kill(os.getpid(), 19)"], before=stopped)
    assert spent.stopped == spent.able > 0


@pytest.mark.native("the time for which a process waits for a CPU")
def test_bytes_end_a_wait() -> None:
    spent = _watched([*PYTHON, "print(flush=True)\nwhile True: open('/proc/self/status').read(); __import__('time').sleep(0.02)"])
    assert not spent.waited and not spent.unmoved and not spent.idle


def test_bytes_are_counted() -> None:
    before = activity.sample(os.getpid())
    data = Path(__file__).read_bytes()
    now = activity.sample(os.getpid())
    assert before is not None and now is not None and now.bytes - before.bytes >= len(data)


def test_a_process_without_a_cpu_is_excused() -> None:
    """Of the lowest class the scheduler has, on a core that others keep busy: it gets next to nothing."""
    core = {max(os.sched_getaffinity(0))}

    def starve(pid: int) -> None:
        os.sched_setaffinity(pid, core)
        os.sched_setscheduler(pid, os.SCHED_IDLE, os.sched_param(0))

    hogs = [subprocess.Popen([*PYTHON, "while True: pass"]) for _ in range(2)]
    try:
        for hog in hogs:
            os.sched_setaffinity(hog.pid, core)
        spent = _watched([*PYTHON, SPINS], 3.0, starve)
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()
    assert spent.able < 1.5e9, "of 3 s"


class Script:
    """Time and samples as a test wants them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **row: int) -> None:
        self.t_ns = 10**12
        monkeypatch.setattr(health_check, "now_ns", lambda: self.t_ns)
        self.row = np.zeros((), ROW)
        self.row["state"] = State.RUNNING
        self.row["ready_ns"] = self.row["started_ns"] = self.row["beat_ns"] = self.t_ns
        for name, value in row.items():
            self.row[name] = value
        self.thread, self.disk = Thread(), 0
        self.judge = HealthCheck(STAGE, self.row, 1, lambda pid: Sample({1: self.thread}, self.disk, self.disk))

    def after(self, seconds: float, each: Callable[[], None] = lambda: None) -> str:
        """Judges ten times a second; the first verdict."""
        for _ in range(round(10 * seconds)):
            self.t_ns += 100 * MS_NS
            each()
            if why := self.judge.problem():
                return why
        return ""


def test_a_disk_is_given_a_minute_for_every_byte_declared_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    for words in (b"", b"reading"):
        script = Script(monkeypatch)
        script.row["busy_with"] = words
        script.thread = Thread(state="D")
        assert script.after(health_check.STALL_S - 1) == ""
        script.disk += 1
        assert script.after(health_check.STALL_S - 1) == ""
        assert "no data from its disk" in script.after(3)


def test_computing_has_its_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    def work(script: Script) -> Callable[[], None]:
        def step() -> None:
            script.thread = attrs.evolve(script.thread, cpu_ns=script.thread.cpu_ns + 100 * MS_NS, state="R")

        return step

    script = Script(monkeypatch, ready_ns=0, state=State.STARTING)
    assert script.after(health_check.LONGEST_S - 1, work(script)) == "" and "not ready" in script.after(3, work(script))
    script = Script(monkeypatch)
    limit_s = health_check.COMPUTING * STAGE.hang_timeout_s
    assert script.after(limit_s, work(script)) == "", "a slow machine is no hang"
    assert "no beat" in script.after(1, work(script))
    script = Script(monkeypatch)
    script.row["busy_with"] = b"decoding"
    assert script.after(STAGE.startup_timeout_s, work(script)) == "" and "decoding: no beat" in script.after(2, work(script))


def test_a_machine_that_gives_no_cpu_at_all_hangs_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script(monkeypatch)
    script.thread = Thread(state="R")  # in the queue, and never out of it
    assert script.after(500) == ""
    script = Script(monkeypatch)

    def crawl() -> None:  # on a CPU for a tenth of the time
        script.thread = Thread(script.thread.cpu_ns + 10 * MS_NS, script.thread.queued_ns + 90 * MS_NS, "R")

    assert script.after(4 * STAGE.hang_timeout_s, crawl) == ""
    assert "no beat" in script.after(50 * STAGE.hang_timeout_s, crawl), "its own time is up"


def test_a_feeder_keeps_a_reader_alive(bench: Bench) -> None:
    """A byte a second is slow, but not hung."""
    process = bench.start("waits for a file")
    assert bench.until(lambda: busy_words(process.row) == "reading a slow file") == ""
    done = threading.Event()

    def feed() -> None:
        with (bench.folder / FIFO).open("wb", buffering=0) as file:
            for _ in range(4):
                file.write(b"x")
                time.sleep(1.0)
        done.set()

    threading.Thread(target=feed).start()
    assert bench.until(lambda: done.is_set() and bench.came_through()) == ""
