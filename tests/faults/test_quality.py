"""Quality on a machine that is too slow: real sessions beside programs that occupy both cores."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from tests.scene.made import views, write_grid
from tests.support.world import World

HOG = (
    "import os, sys\nos.sched_setaffinity(0, {int(sys.argv[1])})\nwhile os.getppid() =="
    " int(sys.argv[2]): pass"
)
pytestmark = pytest.mark.alone
PER_CORE = 12
BEFORE_OTHERS = -15


@pytest.fixture
def before_others() -> Iterator[None]:
    """Test, session and hogs compete with each other, not with other programs of this machine, if
    that is allowed.

    Where the kernel groups processes by terminal session (autogroup) the group's niceness counts,
    elsewhere each process's own.
    """
    group = Path("/proc/self/autogroup")
    own = os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, BEFORE_OTHERS)
        group.write_text(str(BEFORE_OTHERS))
    yield
    os.setpriority(os.PRIO_PROCESS, 0, own)
    with contextlib.suppress(OSError):
        group.write_text("0")


class Hogs:
    """Programs that never sleep, on every core."""

    def __init__(self) -> None:
        self._running: list[subprocess.Popen[bytes]] = []

    def start(self, *cores: int) -> None:
        """On every core, or on those."""
        for core in (cores or tuple(os.sched_getaffinity(0))) * PER_CORE:
            self._running.append(
                subprocess.Popen([sys.executable, "-c", HOG, str(core), str(os.getpid())])
            )

    def end(self) -> None:
        for hog in self._running:
            hog.kill()
            hog.wait(60)
        self._running.clear()


@pytest.fixture
def hogs(before_others: None) -> Iterator[Hogs]:
    made = Hogs()
    yield made
    made.end()


def _level(world: World) -> int:
    """The level of the last line of the trace: cheap, for a test that waits beside hogs."""
    with world.trace.open("rb") as trace:
        trace.seek(max(0, world.trace.stat().st_size - 4096))
        return int(json.loads(trace.read().rpartition(b"\n")[0].rpartition(b"\n")[2])["level"])


def test_quality_goes_down_by_levels_on_a_busy_machine_and_comes_back(
    world: World, hogs: Hogs
) -> None:
    # takes a millisecond or two to warp
    deep = write_grid(world.root / "deep", views(3, 3, 480, 640))
    output = world.root / "output"
    with output.open("w") as err:
        up = world.up(
            deep, "--set", "render.method=warp2", "--set", "render.rate_hz=60", stderr=err
        )
    world.pictures(150)
    with world.tap() as heard:

        def level() -> int:
            heard("level")  # a subscriber that reads too slowly loses messages
            return _level(world)

        hogs.start()
        world.wait_for(lambda: level() >= 1, "lower level")
        lowered = world.monitor()
        world.kill("render")
        count = len(world.lines())
        world.pictures(count + 3)
        restarted = world.lines()[count + 1]["level"]  # the line before may have been on its way
        hogs.end()
        config = world.monitor()["config"]
        world.wait_for(lambda: level() == 0, "full quality again")
        steps = heard("level")
    assert up.poll() is None and restarted >= 1, (
        "a stage that starts again works at the level in force"
    )
    assert config["render"]["method"] == "warp2" and config["render"]["rate_hz"] == 60, (
        "what the person asked for stays"
    )
    assert (
        lowered["level"] >= 1 and lowered["level_words"] != "full" and lowered["lowest_level"] >= 4
    )
    lines = world.lines()
    levels = [
        b["level"] for a, b in pairwise([{"level": None}, *lines]) if a["level"] != b["level"]
    ]
    assert levels[0] == 0 and levels[-1] == 0 and max(levels) >= 1
    # after a change of level, the former compositor draws until the next one is prepared
    drawn = {(line["level"], line["method"]) for line in lines}
    assert (0, "warp2") in drawn and len(drawn) > 1, "which drawing follows is measured"
    assert steps and all(step["words"] and step["why"] for step in steps)
    assert output.read_text().count("picture quality reduced") == 1
    state = world.monitor()
    assert [stage["restarts"] for stage in state["stages"].values()] == [0, 0, 1]
    track = state["stages"]["track"]
    used = track["count"] + track["dropped"] + track["left_out"]
    assert state["stages"]["capture"]["count"] - used <= 8, (
        "every frame is shown, dropped or left out"
    )
