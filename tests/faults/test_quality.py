"""Quality on a machine that is too slow: real sessions beside programs that occupy both cores."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
import zmq

from lfpipe.transport import control
from tests.scene.made import views, write_grid
from tests.world import World

pytestmark = pytest.mark.live

HOG = "import os, sys\nos.sched_setaffinity(0, {int(sys.argv[1])})\nwhile os.getppid() == int(sys.argv[2]): pass"
PER_CORE = 12
BEFORE_OTHERS = -15


@pytest.fixture
def before_others() -> Iterator[None]:
    """Test, session and hogs compete with each other, not with other programs of this machine, if that is allowed.

    Where the kernel groups processes by terminal session (autogroup) the group's niceness counts, elsewhere each process's own.
    """
    group, own = Path("/proc/self/autogroup"), os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, BEFORE_OTHERS)
        group.write_text(str(BEFORE_OTHERS))
    yield
    os.setpriority(os.PRIO_PROCESS, 0, own)
    with contextlib.suppress(OSError):
        group.write_text("0")


@pytest.fixture(scope="module")
def deep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene that takes a millisecond or two to warp."""
    return write_grid(tmp_path_factory.mktemp("scenes") / "deep", views(3, 3, 480, 640))


class Hogs:
    """Programs that never sleep, on every core."""

    def __init__(self) -> None:
        self._running: list[subprocess.Popen[bytes]] = []

    def start(self, *cores: int) -> None:
        """On every core, or on those."""
        for core in (cores or tuple(os.sched_getaffinity(0))) * PER_CORE:
            self._running.append(subprocess.Popen([sys.executable, "-c", HOG, str(core), str(os.getpid())]))

    def end(self) -> None:
        for hog in self._running:
            hog.kill()
        for hog in self._running:
            hog.wait()
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


def _levels(world: World) -> list[int]:
    """The level of each line of the trace, each run of equal ones once."""
    found = [line["level"] for line in world.lines()]
    return [level for i, level in enumerate(found) if not i or level != found[i - 1]]


def test_quality_goes_down_a_level_at_a_time_while_others_have_the_cores_and_comes_back(
    world: World, deep: Path, hogs: Hogs
) -> None:
    said = world.root / "said"
    with said.open("w") as err:
        up = world.up(deep, "--set", "render.method=warp2", "--set", "render.rate_hz=60", stderr=err)
    world.pictures(150)
    with zmq.Context() as ctx, ctx.socket(zmq.SUB) as tap:
        tap.setsockopt(zmq.LINGER, 0)
        tap.subscribe(b"")
        run_dir = next(path.parent for path in world.run_dir.rglob("session.json"))
        control.connect(tap, run_dir, "tap")
        control.request(run_dir, {"cmd": "pictures", "lease_s": 60}, 30)  # then there is something to hear: the tap is connected
        assert tap.poll(10_000)
        hogs.start()
        world.wait_for(lambda: _level(world) >= 1, "lower level")
        hogs.end()
        lowered = world.monitor()
        config = json.loads(world.run("ctl", "--session", world.name, "status", "--json").stdout)["config"]
        world.wait_for(lambda: _level(world) == 0, "full quality again", 60)
        told = []
        while tap.poll(200):
            told.append(control.decode(tap.recv()))
            if told[-1]["topic"] == "level" and told[-1]["level"] == 0:
                break
    assert up.poll() is None
    assert config["render"]["method"] == "warp2" and config["render"]["rate_hz"] == 60, "what the person asked for stays"
    assert lowered["level"] >= 1 and lowered["level_words"] != "full" and lowered["lowest_level"] == 5
    levels = _levels(world)
    assert levels[0] == 0 and levels[-1] == 0 and max(levels) >= 1
    assert all(abs(b - a) == 1 for a, b in pairwise(levels)), "never more than one at a time"
    methods = {line["level"]: line["method"] for line in world.lines()}
    assert methods[0] == "warp2" and methods[1] == "warp"
    steps = [message["level"] for message in told if message["topic"] == "level"]
    assert steps == levels[1:] and all(message["words"] and message["why"] for message in told if message["topic"] == "level")
    assert said.read_text().count("busy computer") == 1
    assert sum(stage["restarts"] for stage in world.monitor()["stages"].values()) == 0
    state = world.monitor()
    assert state["stages"]["capture"]["count"] - _used(state) <= 8, "every frame is shown, dropped or left out"


def _used(state: dict[str, dict[str, dict[str, int]]]) -> int:
    track = state["stages"]["track"]
    return track["count"] + track["dropped"] + track["left_out"]


@pytest.mark.soak
def test_a_stage_that_starts_again_works_at_the_level_in_force(world: World, deep: Path, hogs: Hogs) -> None:
    world.up(deep, "--set", "render.method=warp2", "--set", "render.rate_hz=60")
    world.pictures(150)
    pid = world.monitor()["stages"]["render"]["pid"]
    hogs.start()
    world.wait_for(lambda: _level(world) >= 1, "lower level")
    hogs.end()
    os.kill(pid, signal.SIGKILL)
    count = len(world.lines())
    world.pictures(count + 3)
    assert world.lines()[count]["level"] >= 1 and world.monitor()["stages"]["render"]["restarts"] == 1


def test_frames_left_out_by_tracking_are_not_counted_as_lost_and_no_eyes_are_made_up_for_them(
    world: World, scene: Path, hogs: Hogs
) -> None:
    first, last = min(os.sched_getaffinity(0)), max(os.sched_getaffinity(0))
    where = f"governor.affinity=capture={first},track={last},render={first}"
    sets = ("camera.rate_hz=120", "render.method=nearest", "render.rate_hz=30", where)
    world.up(scene, *(f"--set={word}" for word in sets))
    world.pictures(60)
    before = world.monitor()["stages"]["track"]["left_out"]  # a busy machine may have lowered the quality already
    hogs.start(last)
    world.wait_for(lambda: _level(world) == 1, "lower level")
    hogs.end()
    world.wait_for(lambda: world.monitor()["stages"]["track"]["left_out"] > before + 60, "frames left out")
    state = world.monitor()
    assert state["lowest_level"] == 1 and "every 2nd frame" in state["level_words"]
    assert abs(state["stages"]["capture"]["count"] - _used(state)) <= 8, "every frame is used, lost or left out"
    lowered = [line for line in world.lines() if line["level"] == 1]
    assert all(line["source_seq"] % 2 == 0 for line in lowered[5:-1]) and all(line["face"] for line in lowered[5:-1])
    world.wait_for(lambda: _level(world) == 0, "full quality again", 60)


@pytest.mark.soak
def test_fixed_quality_is_left_alone(world: World, deep: Path, hogs: Hogs) -> None:
    world.up(deep, "--set=render.method=warp2", "--set=render.rate_hz=60", "--set=governor.quality=fixed")
    world.pictures(100)
    hogs.start()
    time.sleep(2.5)
    hogs.end()
    assert _levels(world) == [0] and world.monitor()["lowest_level"] == 0


def test_cores_and_niceness_are_those_of_the_configuration(world: World, scene: Path) -> None:
    first = min(os.sched_getaffinity(0))
    sets = (f"governor.affinity=track={first},render={first}", "governor.nice=track=3,render=1", "governor.quality=fixed")
    world.up(scene, *(f"--set={word}" for word in sets))
    world.pictures(5)
    stages = world.monitor()["stages"]
    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert [stages[name]["cpus"] for name in ("track", "render")] == [[first], [first]]
    assert stages["capture"]["cpus"] == sorted(os.sched_getaffinity(0))
    assert [stages[name]["nice"] for name in ("capture", "track", "render")] == [own, 3, 1]
    shown = world.run("monitor", "--session", world.name, "--once").stdout
    assert "quality: full" in shown and f"track {first} nice 3" in shown


def test_a_session_on_two_cores_has_tracking_on_one_and_the_rest_on_the_other(world: World, scene: Path) -> None:
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        pytest.skip("one core")
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        world.up(scene)
    finally:
        os.sched_setaffinity(0, before)
    world.pictures(5)
    found = {name: stage["cpus"] for name, stage in world.monitor()["stages"].items()}
    assert found == {"capture": [cores[0]], "track": [cores[1]], "render": [cores[0]]}


def test_wrong_cores_and_niceness_end_a_session_before_it_begins(world: World, scene: Path) -> None:
    for word in ("governor.affinity=track=99", "governor.nice=track=99"):
        done = world.run("up", scene, "--camera", "demo", "--display", "none", "--session", world.name, "--set", word)
        assert done.returncode == 2 and word.partition("=")[0] in done.stderr and "remedy" in done.stderr
        assert "Traceback" not in done.stderr
