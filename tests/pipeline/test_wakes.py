"""A session wakes other programs for each slot of a ring, as long as they are connected."""

import os
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from lfpipe.rings import EYES, Wakes, open_ring
from lfpipe.supervisor.requests import MAX_WAKES
from tests.support.refusal import refusal
from tests.support.world import World

PATIENCE_S = 60.0
CLIENT = """
import sys
from lfpipe.rings import Wakes
wakes = Wakes("eyes", sys.argv[1])
print(wakes.wait(60), flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def of_the_world(world: World, scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(world.run_dir))
    world.shows(scene)


def fifos(world: World) -> set[str]:
    """The FIFOs of other programs."""
    stages = {"track", "render", "record", "share", "disparity", "views", "capture"}
    found = {path.name for path in world.session_dir.glob("wake.*")}
    return {name for name in found if name.rpartition(".")[2] not in stages}


def test_wakes_arrive_for_each_slot_also_of_a_restarted_stage(world: World) -> None:
    record = np.zeros((), EYES)
    with Wakes("eyes", world.name) as wakes:
        (name,) = fifos(world)
        reader = open_ring("eyes", world.name)
        for _ in range(20):
            assert wakes.wait(PATIENCE_S)
            before = reader.last_seq
            # a slot is published before its wake, and may be read with the one before
            assert reader.read(record) is not None or before == reader.published
        pid = world.kill("track")
        world.wait_for(
            lambda: world.monitor()["stages"]["track"]["pid"] not in (0, pid), "the restart"
        )
        before = reader.published
        while reader.published == before or reader.epoch == 0:
            assert wakes.wait(PATIENCE_S)
        assert fifos(world) == {name}
        reader.close()
    world.wait_for(lambda: not fifos(world), "end of the FIFO")
    assert world.ask(cmd="hello")["options"]["wakes"] == []


def test_fifo_ends_with_a_killed_program(world: World) -> None:
    client = subprocess.Popen(
        [sys.executable, "-c", CLIENT, world.name],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=world.env,
    )
    assert client.stdout is not None and client.stdout.readline() == "True\n"
    assert len(fifos(world)) == 1
    os.kill(client.pid, signal.SIGKILL)
    client.communicate()
    world.wait_for(lambda: not fifos(world), "end of the FIFO")


def test_wakes_are_limited_and_only_of_rings(world: World) -> None:
    assert "no ring 'pictures'" in str(refusal(Wakes, "pictures", world.name))
    with ExitStack() as held:
        all_wakes = [held.enter_context(Wakes("eyes", world.name)) for _ in range(MAX_WAKES)]
        assert f"{MAX_WAKES} programs" in str(refusal(Wakes, "frames", world.name))
        all_wakes[0].close()
        world.wait_for(lambda: len(fifos(world)) < MAX_WAKES, "a free place")
        held.enter_context(Wakes("frames", world.name))
        assert all(wakes.wait(PATIENCE_S) for wakes in all_wakes[1:])
    world.wait_for(lambda: not fifos(world), "end of all FIFOs")
