"""The monitor on real sessions: the screen in a pseudo-terminal, streams, Prometheus, coming and going."""

import contextlib
import csv
import fcntl
import io
import json
import os
import pty
import re
import select
import signal
import socket
import statistics
import struct
import termios
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from click.testing import CliRunner
from prometheus_client.parser import text_string_to_metric_families

from lfpipe.cli import cli
from lfpipe.observe.session_reader import Watch
from lfpipe.supervisor.rundir import find
from tests.world import World

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

    def until(self, pattern: str, timeout_s: float = 20) -> str:
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

    def ended(self, timeout_s: float = 20) -> int | None:
        """The exit code; what it still writes is taken, as a terminal would."""
        end = time.monotonic() + timeout_s
        while self.process.poll() is None and time.monotonic() < end:
            with contextlib.suppress(OSError):
                if select.select([self._fd], [], [], 0.05)[0]:
                    os.read(self._fd, 65536)
        return self.process.poll()

    def press(self, key: str) -> None:
        os.write(self._fd, key.encode())


def test_the_screen_its_keys_and_a_session_that_starts_again(world: World, scene: Path) -> None:
    world.up(scene)
    world.pictures(5)
    terminal, second = Terminal(world), Terminal(world)
    shown = terminal.until(r"rst: restarts")
    assert "capture running" in shown and "render  running" in shown and "age of pictures" in shown and "q quit" in shown
    assert max(len(line) for line in shown.splitlines()) <= 80
    second.until("running")
    terminal.until(r"viewer (arriving|seated)")
    terminal.until(r"eyes predicted by p50 \d")
    terminal.press("w")
    terminal.until("nearest views")
    second.until("nearest views")
    terminal.press("m")
    terminal.until("dubois-green-magenta anaglyph")
    terminal.press("p")
    terminal.until("PAUSED")
    terminal.press("p")
    terminal.until("resumed")
    terminal.press("r")
    terminal.until("counts reset")
    terminal.press("t")
    terminal.until("recording timeline")
    world.wait_for(lambda: any(part.stat().st_size > 2000 for part in world.root.glob("lfpipe-*.part")), "traced pictures")
    terminal.press("t")
    terminal.until(r"timeline: ")
    assert [path.suffix for path in world.root.glob("lfpipe-*")] == [".json"]
    assert world.run("ctl", "--session", world.name, "stop").returncode == 0
    terminal.until("no session")
    world.wait_for(lambda: not world.left(), "clean end")
    world.trace.unlink()
    world.up(scene)
    terminal.until("capture running")
    for each in (terminal, second):
        each.press("q")
        assert each.ended() == 0


def test_coming_and_going_leaves_nothing_and_costs_no_frame(live: World) -> None:
    world = live
    before = world.segments(), sorted(world.run_dir.rglob("*"))
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(world.run_dir))
        for _ in range(20):
            with Watch(find(world.name)) as watch:
                assert watch.living() and watch.meter.read().stages
    for signum in (signal.SIGKILL, signal.SIGINT):  # whole processes, killed and ended cleanly
        viewer = world.start("monitor", "--session", world.name, "--json")
        assert viewer.stdout is not None and json.loads(viewer.stdout.readline())["session"] == world.name
        viewer.send_signal(signum)
        viewer.communicate(timeout=60)
    assert len(list(Path("/proc/self/fd").iterdir())) <= descriptors + 1
    assert (world.segments(), sorted(world.run_dir.rglob("*"))) == before
    state = world.monitor()
    assert all(stage["restarts"] == 0 for stage in state["stages"].values())


def test_the_horizon_is_what_the_trace_says_and_grows_with_the_displays_own_delay(live: World) -> None:
    live.pictures(90)
    once = live.run("monitor", "--session", live.name, "--once", "--csv")
    row = next(csv.DictReader(io.StringIO(once.stdout)))
    live.pictures(max(len(live.lines()), int(row["horizon.n"])) + 30)  # what the monitor saw is written by then
    counted = [line for line in live.lines() if line["face"]][: int(row["horizon.n"])]
    horizon_ms = statistics.median((line["t_presented_ns"] - line["t_sensor_ns"]) / 1e6 for line in counted) + 100 + 1e3 / 120
    assert len(counted) >= 60 and float(row["horizon.p50_ms"]) == pytest.approx(horizon_ms, rel=0.1)
    assert row["motion_to_photon.onset_ms"] == "", "no light without a screen"


def test_streams_and_wrong_words(live: World) -> None:
    world = live
    once = world.run("monitor", "--session", world.name, "--once", "--csv")
    rows = list(csv.DictReader(io.StringIO(once.stdout)))
    assert len(rows) == 1 and float(rows[0]["render.fps"]) > 0 and int(rows[0]["track.dropped"]) >= 0
    assert "age of the picture" in world.run("monitor", "--session", world.name, "--once").stdout
    for words in (("--json", "--csv"), ("--web", "--json"), ("--once", "--web"), ("--port", "1")):
        assert CliRunner().invoke(cli, ["monitor", "--session", world.name, *words]).exit_code == 2
    plain = Terminal(world, term="dumb")
    plain.until(r"drops restarts[^\x1b]*drops restarts")  # sample after sample, with nothing but text
    plain.process.send_signal(signal.SIGINT)
    assert plain.ended() == 130
    missing = world.run("monitor", "--session", "nobody")
    assert missing.returncode == 2 and "no session 'nobody'" in missing.stderr


def test_prometheus_reads_what_is_served(world: World, scene: Path) -> None:
    exporter = world.start("monitor", "--session", world.name, "--prometheus", ":0")
    assert exporter.stdout is not None
    url = re.search(r"http://127\.0\.0\.1:\d+/metrics", exporter.stdout.readline())
    assert url is not None

    def scrape() -> dict[str, list[tuple[dict[str, str], float]]]:
        with urllib.request.urlopen(url.group(), timeout=60) as answer:
            families = text_string_to_metric_families(answer.read().decode())
            return {
                sample.name: [(s.labels, s.value) for s in family.samples if s.name == sample.name]
                for family in families
                for sample in family.samples
            }

    assert scrape()["lfpipe_up"][0][1] == 0, "a session may come later"
    world.up(scene)
    world.pictures(30)
    found = scrape()
    assert found["lfpipe_up"][0][1] == 1 and found["lfpipe_camera_hz"][0][1] > 10
    ages = [value for _, value in found["lfpipe_picture_age_seconds_bucket"]]
    assert ages == sorted(ages) and ages[-1] == found["lfpipe_picture_age_seconds_count"][0][1] > 0
    stages = {labels["stage"] for labels, _ in found["lfpipe_stage_seconds_count"]}
    assert {"capture", "track", "render"} <= stages
    address = url.group().split("/")[2]
    threads = len(list(Path(f"/proc/{exporter.pid}/task").iterdir()))
    halves = [socket.create_connection(("127.0.0.1", int(address.split(":")[1]))) for _ in range(300)]
    for half in halves:
        half.sendall(b"GET /metrics HTTP/1.1\r\n")
    assert scrape()["lfpipe_up"][0][1] == 1
    assert len(list(Path(f"/proc/{exporter.pid}/task").iterdir())) == threads
    for half in halves:
        half.close()
    for wrong in ("/camera.jpg", "/metrics/x"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(url.group().replace("/metrics", wrong), timeout=60)
    pointed_here = urllib.request.Request(url.group(), headers={"Host": "example.org"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(pointed_here, timeout=60)
    busy = world.run("monitor", "--session", world.name, "--prometheus", address)
    assert busy.returncode == 2 and "another port" in busy.stderr
