"""SIGSTOP and SIGCONT of each process and of all of them, as by a suspended machine, a debugger or
a starved host.
"""

import shutil
import signal
from pathlib import Path

import psutil
import pytest

from lfpipe.eyes import MAX_STEP_NS
from lfpipe.transport.ring import SleepWatch
from tests.support.world import World
from tests.support.xvfb_screen import x_server

RATE_HZ = 30


def test_sleep_watch_notices_a_sleep_once() -> None:
    asleep_ns = 5_000_000_000
    watch = SleepWatch(lambda: asleep_ns)
    assert not watch.woke()
    asleep_ns += MAX_STEP_NS - 1
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
