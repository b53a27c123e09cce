"""What the processes of a session hold for its whole length: libraries, and shared memory."""

import re
from pathlib import Path

import psutil
import pytest

from tests.support.world import World
from tests.support.xvfb_screen import Screen

# what only some stages need: 97 MB
LIBRARIES = re.compile(r"/(cv2|pygame|PIL|skimage|scipy)/")


def libraries(pid: int) -> set[str]:
    return set(LIBRARIES.findall(Path(f"/proc/{pid}/maps").read_text()))


@pytest.mark.native("/proc lists what a process has mapped")
def test_a_session_holds_what_its_stages_need(world: World, scene: Path, screen: Screen) -> None:
    world.env["DISPLAY"] = screen.name
    process = world.shows(scene, camera="mouse", display="window")
    pids = {name: one["pid"] for name, one in world.monitor()["stages"].items() if one["pid"]}
    assert libraries(pids["render"]) >= {"cv2", "pygame"}
    assert not world.segments("frames"), "nobody writes frames"
    assert world.ask(cmd="viewer", source="demo")["ok"]
    assert world.segments("frames")
    world.wait_for(lambda: world.monitor()["stages"]["track"]["face"], "its eyes")
    assert world.ask(cmd="viewer", source="mouse")["ok"]
    assert world.ask(cmd="viewer", source="demo")["ok"]
    assert world.ask(cmd="load", scene=str(scene))["ok"]
    world.wait_for(lambda: world.monitor()["stages"]["track"]["face"], "its eyes again")
    assert not libraries(process.pid)
    descriptors: list[list[int]] = []
    for _ in range(10):
        for source in ("mouse", "demo"):
            assert world.ask(cmd="viewer", source=source)["ok"]
        world.wait_for(lambda: world.monitor()["stages"]["track"]["face"], "its eyes again")
        descriptors.append([psutil.Process(pid).num_fds() for pid in (pids["render"], process.pid)])
    assert descriptors[2] == descriptors[-1], "exchanges hold nothing"
    world.ctl("stop")
    world.ended(process)
