"""SIGSTOP and SIGCONT of each process and of all of them, as by a suspended machine, a debugger or
a starved host.
"""

import itertools
import os
import shutil
import signal
import time
from pathlib import Path

import psutil
import pytest

from lfpipe.supervisor.stage_process import HANG_S
from lfpipe.transport.clock import SLEPT_NS, SleepWatch
from tests.support.world import World
from tests.support.xvfb_screen import x_server

RATE_HZ = 30


def _presented(world: World, t_ns: int) -> list[int]:
    return [t for line in world.lines() if (t := line["t_presented_ns"]) >= t_ns]


def _back_at(world: World, t_ns: int, rate_hz: float) -> bool:
    """Whether half a second since t_ns had pictures at nine tenths of the rate or more."""
    stamps = _presented(world, t_ns)
    return any(b - a <= 5e8 for a, b in zip(stamps, stamps[int(0.45 * rate_hz) :], strict=False))


def test_processes_stopped_and_continued_are_back_at_rate(
    world: World, scene: Path, clip: Path
) -> None:
    sets = (
        "--set",
        "render.clock=display",
        "--set",
        f"render.rate_hz={RATE_HZ}",
        "--set",
        "render.method=nearest",
    )
    supervisor = world.shows(
        scene,
        *sets,
        camera=f"file:{clip}?loop=1&pace={RATE_HZ}",
        start_new_session=True,
        pictures=30,
    )
    before = {name: stage["pid"] for name, stage in world.monitor()["stages"].items()}
    pids = {name: [pid] for name, pid in before.items()} | {"supervisor": [supervisor.pid]}
    pids["all"] = list(itertools.chain.from_iterable(pids.values()))
    # longer and shorter than a stage may be silent
    long_s = HANG_S + 0.4
    short_s = 1.2
    for name, for_s in (("all", long_s), ("render", short_s), ("supervisor", long_s)):
        t_from_ns = time.monotonic_ns()
        world.wait_for(
            lambda t=t_from_ns: len(_presented(world, t)) > RATE_HZ, "a second of pictures"
        )
        t_stop_ns = time.monotonic_ns()
        usual_hz = min(RATE_HZ, len(_presented(world, t_stop_ns - 10**9)))
        for pid in pids[name]:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(for_s)
        if name == "supervisor":
            wanted = 0.8 * usual_hz * for_s
            world.wait_for(
                lambda t=t_stop_ns, n=wanted: len(_presented(world, t)) >= n,
                "pictures, which need no supervisor",
            )
        t_go_ns = time.monotonic_ns()
        for pid in pids[name]:
            os.kill(pid, signal.SIGCONT)
        world.wait_for(lambda t=t_go_ns, hz=usual_hz: _back_at(world, t, hz), "usual rate")
        stamps = _presented(world, t_go_ns)
        burst = max(sum(t <= other < t + 100_000_000 for other in stamps) for t in stamps)
        assert burst <= 0.1 * RATE_HZ * 2 + 1, f"{name}: missed time is skipped, not made up for"
    after = world.monitor()["stages"]
    assert {name: (stage["pid"], stage["restarts"]) for name, stage in after.items()} == {
        name: (pid, 0) for name, pid in before.items()
    }, "no stage counted as hung"


def test_sleep_watch_notices_a_sleep_once() -> None:
    asleep_ns = 5_000_000_000
    watch = SleepWatch(lambda: asleep_ns)
    assert not watch.woke()
    asleep_ns += SLEPT_NS - 1
    assert not watch.woke(), "the clocks are not read at the same moment"
    asleep_ns += 1
    assert watch.woke() and not watch.woke()
    assert not SleepWatch().woke(), "this machine has not slept in between"


@pytest.mark.native("stops a server of X")
def test_render_waits_for_a_screen_that_hangs_and_not_for_itself(
    world: World, scene: Path, tmp_path: Path
) -> None:
    if shutil.which("Xvfb") is None:
        pytest.skip("apt-get install xvfb")
    command = ["Xvfb", "-screen", "0", "640x480x24", "-fbdir", str(tmp_path), "-nocursor"]
    with x_server(command, tmp_path) as name:
        world.env["DISPLAY"] = name
        world.shows(scene, display="window", pictures=10)
        stage = world.monitor()["stages"]["render"]
        children = (one for one in psutil.Process().children() if one.name() == "Xvfb")
        server = max(children, key=psutil.Process.create_time)
        server.suspend()
        try:
            world.wait_for(
                lambda: "screen, 5 s" in world.monitor()["stages"]["render"]["busy_with"],
                "longer than a stage may be silent",
            )
        finally:
            server.resume()
        world.more_pictures(10)
        after = world.monitor()["stages"]["render"]
        assert (after["pid"], after["restarts"]) == (stage["pid"], 0)
        world.kill("render", signal.SIGSTOP)
        world.wait_for(lambda: world.monitor()["stages"]["render"]["restarts"] == 1, "restart")
        world.more_pictures(10)
        world.ctl("stop")
