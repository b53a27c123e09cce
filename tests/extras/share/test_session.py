"""A session that shares its eyes with independent programs."""

import math
import os
import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import psutil
import pytest

from lfpipe.transport.ring import SECOND_NS
from tests.extras.share.receivers import OpentrackReceiver, free_port, lsl_environment, osc_server
from tests.support.world import World

pytestmark = pytest.mark.live
LSL_NAME = f"test{os.getpid()}"


@attrs.define
class Sharing:
    """A session that shares with everybody. heard: what came by OSC."""

    world: World
    opentrack_port: int
    osc_port: int
    heard: list[tuple[str, tuple[Any, ...]]]
    opentrack: OpentrackReceiver


@pytest.fixture(scope="module")
def sharing(tmp_path_factory: pytest.TempPathFactory, scene: Path) -> Iterator[Sharing]:
    config = lsl_environment(tmp_path_factory.mktemp("lsl"))
    os.environ |= config  # of liblsl in this process, read when it is loaded
    ports = free_port(), free_port()
    targets = (f"opentrack:localhost:{ports[0]}", f"osc:127.0.0.1:{ports[1]}", f"lsl:{LSL_NAME}")
    options = [word for text in targets for word in ("--share", text)]
    with (
        World(tmp_path_factory.mktemp("sharing")) as world,
        closing(OpentrackReceiver(ports[0])) as opentrack,
        osc_server(ports[1]) as heard,
        world.entered(),
    ):
        world.env |= config
        world.shows(scene, *options, "--set=render.method=nearest", "--set=render.anaglyph=colour")
        world.wait_for(lambda: len(heard) > 30, "frames by OSC")
        yield Sharing(world, *ports, heard, opentrack)


def test_opentrack_gets_the_pose_in_its_layout(sharing: Sharing) -> None:
    """The demo's portrait stands 600 mm before the camera, moves by some 70 px and leans by 3
    degrees.
    """
    poses = np.array(sharing.opentrack.poses(60))
    x_cm, y_cm, z_cm, yaw, pitch, roll = poses.T
    assert (
        np.all((z_cm > 50) & (z_cm < 70))
        and np.all(np.abs(x_cm) < 20)
        and np.all(np.abs(y_cm) < 12)
    )
    assert np.ptp(x_cm) > 0.5, "the head moves"
    assert np.all(np.abs(yaw) < 25) and np.all(np.abs(pitch) < 25) and np.all(np.abs(roll) < 10)


def test_osc_gets_the_eyes_of_every_frame_and_the_head_between_them(sharing: Sharing) -> None:
    first = len(sharing.heard)
    sharing.world.wait_for(lambda: len(sharing.heard) > first + 90, "30 frames by OSC")
    heard = sharing.heard[first:]
    triples = [
        triple
        for triple in zip(heard, heard[1:], heard[2:], strict=False)
        if triple[2][0] == "/lfpipe/head"
    ]
    sensor = {line["source_seq"]: line["t_sensor_ns"] for line in sharing.world.lines()}
    seqs = [frame[1] for (_, frame), _, _ in triples]
    assert len(seqs) > 20 and seqs == sorted(set(seqs))
    for (_, frame), (_, eyes), (_, head) in triples:
        t_ns = frame[2] * SECOND_NS + frame[3]
        assert frame[0] == 1 and t_ns == sensor.get(frame[1], t_ns)
        assert head[:3] == pytest.approx(np.mean([eyes[:3], eyes[3:]], axis=0), abs=1e-3)
        assert math.dist(eyes[:3], eyes[3:]) == pytest.approx(63, rel=0.06)


def test_nothing_is_open_to_anybody_unless_asked(live: World) -> None:
    pids = [stage["pid"] for stage in live.monitor()["stages"].values()]
    assert len(pids) == 3
    supervisor = psutil.Process(pids[0]).parent()
    assert supervisor is not None
    for process in (supervisor, *map(psutil.Process, pids)):
        ports = [each.laddr.ip for each in process.net_connections("inet")]
        assert not set(ports)


def test_without_a_picture_the_eyes_alone(world: World) -> None:
    port = free_port()
    words = ("--no-picture", "--camera", "demo", "--session", world.name)
    with closing(OpentrackReceiver(port)) as receiver:
        process = world.start("up", *words, "--share", f"opentrack:127.0.0.1:{port}")
        assert len(receiver.poses(20)) == 20
        stages = world.monitor()["stages"]
        running = {name for name, stage in stages.items() if stage["state"] == "RUNNING"}
        assert running == {"capture", "track", "share"} and stages["render"]["state"] == "NONE"
        world.wait_for(lambda: world.monitor()["viewer"] == "seated", "a viewer by the face alone")
        assert "no picture" in world.ended(process, signal.SIGINT)
