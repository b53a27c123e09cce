"""SIGSTOP and SIGCONT of each process and of all of them, as by a suspended machine, a debugger or a starved host."""

import ast
import itertools
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

import lfpipe
from lfpipe.render.refresh import Refresh
from lfpipe.supervisor.process_table import STAGES
from lfpipe.transport.clock import SLEPT_NS, SleepWatch
from lfpipe.transport.session import Session
from lfpipe.transport.status import Table
from tests.world import World

RATE_HZ = 30
BACK_S, PATIENCE_S = 1.0, 60.0  # promised on a machine of its own, on any


def _rows(world: World) -> dict[str, dict[str, int]]:
    table = Table(Session(world.name).segment("status"))
    try:
        names = ("pid", "restarts", "drops", "seq", "source_seq")
        return {stage: {name: int(row[name]) for name in names} for stage, row in table.rows.items() if row["state"]}
    finally:
        table.close()


def _presented(world: World, t_ns: int) -> list[int]:
    return [t for line in world.lines() if (t := line["t_presented_ns"]) >= t_ns]


def back_to_rate_s(world: World, t_ns: int, rate_hz: float, span_s: float = 0.5) -> float | None:
    """Time from t_ns to the first picture that begins span_s at nine tenths of the rate or more; None if there is none."""
    stamps = _presented(world, t_ns)
    needed = int(0.9 * rate_hz * span_s)
    first = (a for a, b in zip(stamps, stamps[needed:], strict=False) if b - a <= span_s * 1e9)
    return next(((a - t_ns) / 1e9 for a in first), None)


def _stopped(pids: list[int], for_s: float) -> tuple[int, int]:
    """Stops and continues processes; the times."""
    t_stop_ns = time.monotonic_ns()
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(for_s)
    t_go_ns = time.monotonic_ns()
    for pid in pids:
        os.kill(pid, signal.SIGCONT)
    return t_stop_ns, t_go_ns


@pytest.mark.live
@pytest.mark.parametrize(("clock", "most_s"), [pytest.param("camera", BACK_S, marks=pytest.mark.soak), ("display", PATIENCE_S)])
def test_stopped_and_continued_each_process_and_all_are_back_at_rate(
    world: World, scene: Path, clip: Path, clock: str, most_s: float
) -> None:
    sets = ("--set", f"render.clock={clock}", "--set", f"render.rate_hz={RATE_HZ}", "--set", "render.method=nearest")
    supervisor = world.up(scene, *sets, camera=f"file:{clip}?loop=1&pace={RATE_HZ}", start_new_session=True)
    world.pictures(30)
    before = _rows(world)
    pids = {name: [row["pid"]] for name, row in before.items()} | {"supervisor": [supervisor.pid]}
    pids["all"] = list(itertools.chain.from_iterable(pids.values()))
    long_s, short_s = STAGES[0].hang_timeout_s + 0.4, 1.2  # longer and shorter than a stage may be silent
    plan = [("all", long_s), ("render", short_s)]
    if clock == "camera":
        plan += [("supervisor", long_s), ("capture", short_s), ("track", short_s)]
    for name, for_s in plan:
        time.sleep(1.0)
        usual_hz = min(RATE_HZ, len(_presented(world, time.monotonic_ns() - 10**9)))
        t_stop_ns, t_go_ns = _stopped(pids[name], for_s)
        world.wait_for(lambda t=t_go_ns, hz=usual_hz: back_to_rate_s(world, t, hz) is not None, "usual rate", PATIENCE_S)
        taken_s = back_to_rate_s(world, t_go_ns, usual_hz)
        assert taken_s is not None and taken_s <= most_s, f"{name}: back at rate after {taken_s:.2f} s"
        stamps = _presented(world, t_go_ns)
        burst = max(sum(t <= other < t + 100_000_000 for other in stamps) for t in stamps)
        assert burst <= 0.1 * RATE_HZ * 2 + 1, f"{name}: missed time is skipped, not made up for"
        if name == "supervisor":
            during = [t for t in _presented(world, t_stop_ns) if t < t_go_ns]
            assert len(during) >= 0.8 * usual_hz * for_s, "pictures need no supervisor"
    after = _rows(world)
    assert {name: (row["pid"], row["restarts"]) for name, row in after.items()} == {
        name: (row["pid"], 0) for name, row in before.items()
    }, "no stage counted as hung"


@pytest.mark.parametrize("gap_s", [3.0, 3600.0])
def test_after_a_gap_the_display_finds_the_cameras_new_phase_at_once(gap_s: float) -> None:
    t_ns, period_ns, refresh_ns = 10**12, 10**9 // 30, 10**9 / 60
    refresh = Refresh(60.0, t_ns)
    for seq in range(100):
        t_ns += period_ns
        refresh.advance(t_ns)
        refresh.heard(seq, t_ns, t_ns, 0)
    settled_ns = (refresh.due_ns() - t_ns) % refresh_ns
    t_ns += int(gap_s * 1e9) + 7_000_000  # neither a whole number of refreshes nor of frames
    for seq in range(100, 103):
        t_ns += period_ns
        refresh.advance(t_ns)
        refresh.heard(seq, t_ns, t_ns, 0)
    off_ns = abs((refresh.due_ns() - t_ns) % refresh_ns - settled_ns)
    assert min(off_ns, refresh_ns - off_ns) < 0.02 * refresh_ns


def test_a_sleep_of_the_machine_is_noticed_once() -> None:
    asleep_ns = 5_000_000_000
    watch = SleepWatch(lambda: asleep_ns)
    assert not watch.woke()
    asleep_ns += SLEPT_NS - 1
    assert not watch.woke(), "the clocks are not read at the same moment"
    asleep_ns += 1
    assert watch.woke() and not watch.woke()
    assert not SleepWatch().woke(), "this machine has not slept in between"


def test_no_process_of_a_session_reads_the_wall_clock_after_its_start() -> None:
    """So a step of the clock has no effect: only names and dates of files use it."""
    wall: dict[str, Any] = {"time": {"time", "time_ns", "gmtime", "localtime"}, "datetime": {"now", "utcnow", "today"}}
    root = Path(lfpipe.__file__).parent
    for room in ("capture", "track", "render", "transport", "supervisor", "sequence", "replays"):
        for path in sorted((root / room).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    assert node.attr not in wall.get(node.value.id, ()), f"{path.name}: {node.value.id}.{node.attr}"
