"""Whole sessions on the real driver. In software emulation they take minutes: imports are some 30 times slower."""

from __future__ import annotations

import json
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
def test_a_face_is_tracked_as_well_as_from_the_file() -> None:
    from lfpipe.track.litert_engine import LitertEngine

    engine, size = LitertEngine(), (320, 240)
    settings = config.Camera(width_px=size[0], height_px=size[1], rate_hz=5.0)
    demo, frame = open_source("demo", settings), np.empty((240, 320, 3), np.uint8)
    eyes: list[np.ndarray] = []
    frames = []
    for _ in range(6):
        demo.read(frame)
        frames.append(frame.copy())
    with driver.loopback("YUYV", size) as (path, feeder):
        feeder.start(cv2.cvtColor(frames[0], cv2.COLOR_BGR2YUV_YUY2).tobytes())
        camera, out = open_camera(path, settings), np.empty_like(frame)
        for picture in frames[::5]:
            feeder.frame = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_YUY2).tobytes()
            for _ in range(8):
                camera.read(out)
            for each in (picture, out):
                engine.detect(each)
                face = engine.detect(each)
                assert face is not None
                eyes.append(face.eyes_px)
        camera.close()
    apart = [float(np.abs(eyes[k] - eyes[k + 1]).max()) for k in range(0, len(eyes), 2)]
    print(json.dumps({"apart_px": apart}))
    assert max(apart) < 1.0
