"""One session, fault after fault: pictures come again after each, and nothing piles up."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

from lfpipe.transport.segment import SHM_DIR
from tests.world import World

HOG = [sys.executable, "-c", "import time\nend = time.time() + 2\nwhile time.time() < end: pass"]


def test_a_session_outlives_a_row_of_random_faults(world: World, scene: Path) -> None:
    supervisor = world.up(scene, "--set", "render.clock=camera", "--set", "render.method=nearest")
    world.pictures(10)
    fds = len(list(Path(f"/proc/{supervisor.pid}/fd").iterdir()))
    segments = sorted(path.name for path in SHM_DIR.glob(f"lfpipe-*{world.name}*"))
    rng = random.Random(3)
    restarts = 0
    faults = ["kill", "term", "stop", "term", "monitor", "hog", "kill", "watch and leave"]
    for i, fault in enumerate(faults):
        stage = ("capture", "track", "render")[i % 3] if i else rng.choice(["capture", "track", "render"])
        pid = world.monitor()["stages"][stage]["pid"]
        if fault in ("kill", "term"):
            os.kill(pid, signal.SIGKILL if fault == "kill" else signal.SIGTERM)
            restarts += 1
        elif fault == "stop":  # as long as a hang may last and longer
            os.kill(pid, signal.SIGSTOP)
            restarts += 1
        elif fault == "monitor":
            watcher = world.start("monitor", "--session", world.name, "--json")
            time.sleep(0.5)
            watcher.kill()
        elif fault == "hog":
            hogs = [subprocess.Popen(HOG) for _ in range(2)]
            for hog in hogs:
                hog.wait()
        else:
            assert world.run("monitor", "--session", world.name, "--once", "--json").returncode == 0
        if fault in ("kill", "term", "stop"):
            world.wait_for(lambda n=restarts: _restarts(world) == n, f"restart {restarts} after {fault} of {stage}")
        count = len(world.lines())
        world.pictures(count + 5)
    assert supervisor.poll() is None
    assert len(list(Path(f"/proc/{supervisor.pid}/fd").iterdir())) <= fds + 2
    assert sorted(path.name for path in SHM_DIR.glob(f"lfpipe-*{world.name}*")) == segments
    children = Path(f"/proc/{supervisor.pid}/task/{supervisor.pid}/children").read_text().split()
    assert len(children) == 4, "three stages and the tracker of shared memory"
    lines = world.lines()
    assert [line["seq"] for line in lines] == sorted({line["seq"] for line in lines}), "no line torn, doubled or out of order"


def _restarts(world: World) -> int:
    done = world.run("monitor", "--session", world.name, "--once", "--json")
    if done.returncode:
        return -1
    stages = json.loads(done.stdout)["stages"].values()
    return sum(s["restarts"] for s in stages) if all(s["state"] in ("RUNNING", "NONE") for s in stages) else -1
