"""The monitor on real sessions: the screen in a pseudo-terminal, streams, coming and going."""

import contextlib
import fcntl
import io
import json
import os
import pty
import re
import select
import signal
import struct
import termios
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console, Group, RenderableType

from lfpipe.config import converter
from lfpipe.monitor.monitor import metric_lines, state_view
from lfpipe.monitor.session_reader import Watch
from lfpipe.supervisor.metrics import SessionMetrics, session_metrics
from lfpipe.supervisor.process_table import CORE, METRICS, SOURCE
from lfpipe.supervisor.rundir import find
from lfpipe.transport.status import ROW, SESSION, Histogram, Row, State
from tests.support.world import World

ESCAPES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


class Terminal:
    """`lfpipe monitor` in a terminal of 80x24."""

    def __init__(self, world: World, *args: str, term: str = "xterm-256color") -> None:
        self._fd, inner = pty.openpty()
        fcntl.ioctl(inner, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        env = {**world.env, "TERM": term, "NO_COLOR": "1"}
        env.pop("COLUMNS", None)
        pipes = {"stdin": inner, "stdout": inner, "stderr": inner, "text": False, "env": env}
        self.process = world.start("monitor", "--session", world.name, *args, **pipes)
        os.close(inner)
        self.raw = ""

    def until(self, pattern: str, timeout_s: float = 60) -> str:
        """The text since the last match, up to and including the match."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if found := re.search(pattern, ESCAPES.sub("", self.raw)):
                text = ESCAPES.sub("", self.raw)[: found.end()]
                self.raw = ""
                return text
            if select.select([self._fd], [], [], 0.1)[0]:
                self.raw += os.read(self._fd, 65536).decode(errors="replace")
        raise AssertionError(f"no {pattern!r} in {ESCAPES.sub('', self.raw)[-2000:]!r}")

    def ended(self, timeout_s: float = 60) -> int | None:
        """The exit code; what it still writes is taken, as a terminal would."""
        end = time.monotonic() + timeout_s
        while self.process.poll() is None and time.monotonic() < end:
            with contextlib.suppress(OSError):
                if select.select([self._fd], [], [], 0.05)[0]:
                    os.read(self._fd, 65536)
        return self.process.poll()

    def press(self, key: str) -> None:
        os.write(self._fd, key.encode())


def quality() -> np.ndarray:
    return np.zeros((), SESSION)


def shown(view: RenderableType, width: int = 80) -> list[str]:
    """The lines of a view in a terminal of that width."""
    console = Console(width=width, file=io.StringIO())
    with console.capture() as captured:
        console.print(view)
    return captured.get().splitlines()


def test_state_reports_a_missing_camera() -> None:
    rows = {name: np.zeros((), ROW) for name in CORE}
    for state, words in ((State.NONE, "no camera"), (State.STARTING, "camera 0.0 Hz")):
        rows[SOURCE]["state"] = state
        metrics = session_metrics("mine", rows, METRICS, quality(), 0)
        assert words in shown(state_view(metrics))[0]


def test_table_of_stages_has_its_quantiles_in_order() -> None:
    rows = {name: np.zeros((), ROW) for name in CORE}
    rows[SOURCE]["state"] = State.RUNNING
    busy = Histogram(rows[SOURCE]["busy"])
    for ms, count in ((2, 90), (20, 7), (200, 3)):
        for _ in range(count):
            busy.add_ns(ms * 1_000_000)
    lines = shown(state_view(session_metrics("mine", rows, METRICS, quality(), 0)))
    (line,) = (line for line in lines if line.startswith(SOURCE))
    times = [float(word) for word in line.split()[-7:-2]]
    assert times[1:4] == pytest.approx([2, 20, 200], rel=0.02), "p50, p95 and p99 of the busy time"


def test_monitor_lists_the_metrics_that_stages_declare() -> None:
    rows = {name: np.zeros((), ROW) for name in CORE}
    for row in rows.values():
        row["state"] = State.RUNNING
    render = Row(rows["render"], METRICS["render"])
    render["juddered"], render["onset_ns"] = 3, 61_200_000
    Row(rows["track"], METRICS["track"])["face"] = 1
    metrics = session_metrics("mine", rows, METRICS, quality(), 0)
    printed = shown(Group(*metric_lines(converter().structure(metrics.to_dict(), SessionMetrics))))
    assert "track face yes" in printed
    assert "juddered 3, onset_ms 61.2, steady_ms -" in " ".join(" ".join(printed).split())
    assert max(map(len, printed)) <= 80


def test_monitor_screen_keys_and_a_session_that_starts_again(world: World, scene: Path) -> None:
    world.shows(scene)
    terminal, second = Terminal(world), Terminal(world)
    terminal.until("age of the picture")
    # render opens its scene again once the disparity is there
    shown = terminal.until(r"(?s)capture running.*render  running.*q quit.*rst: restarts")
    newest = shown[shown.rindex("lfpipe ") :]  # without what was left of the screen before
    assert max(len(line) for line in newest.splitlines()) <= 80, newest
    terminal.until(r"viewer (arriving|seated)")
    terminal.until(r"eyes predicted ahead of the sensor by p50 \d")
    for key, answer in (
        ("p", "PAUSED"),
        ("p", "resumed"),
        ("c", "recentred"),
        ("r", "counts reset"),
        ("t", "trace: /"),  # of the session's start: there is one
        ("t", "tracing to"),
    ):
        terminal.press(key)
        terminal.until(answer)
    world.ctl("set", "render.method=nearest")
    for each in (terminal, second):
        each.until("nearest views")
    world.wait_for(
        lambda: any(trace.stat().st_size > 2000 for trace in world.root.glob("lfpipe-*.jsonl")),
        "traced pictures",
    )
    terminal.press("t")
    terminal.until(r"trace: /")
    assert [path.suffix for path in world.root.glob("lfpipe-*")] == [".jsonl"]
    world.ctl("stop")
    terminal.until("no session")
    world.wait_for(lambda: not world.left(), "clean end")
    world.trace.unlink()
    world.up(scene)
    terminal.until("capture running")
    for each in (terminal, second):
        each.press("q")
        assert each.ended() == 0


def test_monitor_leaves_nothing_and_costs_no_frame(live: World) -> None:
    before = sorted(live.run_dir.rglob("*"))
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    with live.entered():
        for _ in range(20):
            with contextlib.closing(Watch(find(live.name))) as watch:
                assert watch.is_running() and watch.read().stages
    for signum in (signal.SIGKILL, signal.SIGINT):  # whole processes, killed and ended cleanly
        viewer = live.start("monitor", "--session", live.name, "--json")
        assert (
            viewer.stdout is not None
            and json.loads(viewer.stdout.readline())["session"] == live.name
        )
        viewer.send_signal(signum)
        viewer.communicate(timeout=60)
    assert len(list(Path("/proc/self/fd").iterdir())) <= descriptors + 1
    assert sorted(live.run_dir.rglob("*")) == before
    assert all(stage["restarts"] == 0 for stage in live.monitor()["stages"].values())


def test_monitor_streams_and_refuses_conflicting_options(live: World) -> None:
    assert live.monitor()["stages"]["render"]["fps"] > 0
    assert "age of the picture" in live.run("monitor", "--session", live.name, "--once").stdout
    assert re.search(r"over \d+ pictures", live.run("ctl", "status", "--session", live.name).stdout)
    plain = Terminal(live, term="dumb")
    plain.until(r"drops rst[^\x1b]*quality")  # nothing but text
    assert plain.ended() == 0
    assert live.run("monitor", "--session", "nobody").returncode == 2
