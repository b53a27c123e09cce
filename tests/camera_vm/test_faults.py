"""Each fault of the driver: the picture returns, and its cost is recorded."""

import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.camera import check_camera
from lfpipe.capture.open_source import check_source, open_reconnecting
from lfpipe.capture.reconnecting_camera import ReconnectingCamera
from lfpipe.errors import UserError
from tests.camera_vm import driver
from tests.camera_vm.driver import Cost, cost_of, inject, plug, read, unload

pytestmark = pytest.mark.camera_vm
CAMERA = config.Camera(width_px=320, height_px=180, rate_hz=10.0)
HZ = 10.0


def opened(text: str) -> ReconnectingCamera:
    source = open_reconnecting(text, CAMERA)
    assert isinstance(source, ReconnectingCamera)
    return source


@pytest.fixture
def camera(vivid: Path) -> Iterator[ReconnectingCamera]:
    made = opened(f"camera:{vivid}")
    yield made
    made.close()


@pytest.mark.parametrize(
    ("fault", "control", "frames"),
    [
        ("damaged buffer", driver.BUFFER_ERROR, 1),
        ("QBUF fails once", driver.QBUF_ERROR, 0),
        ("fatal streaming error", driver.FATAL_ERROR, None),  # reconnects
    ],
)
def test_a_fault_while_streaming(vivid: Path, camera: ReconnectingCamera, fault: str, control: int, frames: int | None) -> None:
    cost = cost_of(fault, camera, HZ, lambda: inject(vivid, control))
    assert cost.lost == (frames is None)
    if frames is not None:
        assert frames <= cost.frames <= frames + 2  # the guest itself may be late once


@pytest.mark.parametrize(
    ("fault", "control"), [("REQBUFS fails once", driver.REQBUFS_ERROR), ("STREAMON fails once", driver.STREAMON_ERROR)]
)
def test_a_fault_at_the_start(vivid: Path, fault: str, control: int) -> None:
    inject(vivid, control)
    began = time.monotonic()
    camera = opened(f"camera:{vivid}")
    _, lost = read(camera, np.empty((180, 320, 3), np.uint8))
    camera.close()
    assert not lost, "tried twice before the camera counts as lost"
    driver.record(fault, Cost(0, time.monotonic() - began, lost))


def test_frames_that_the_driver_drops_are_counted(vivid: Path, camera: ReconnectingCamera) -> None:
    cost = cost_of("30 % of buffers dropped", camera, HZ, lambda: inject(vivid, driver.DROPPED_PERCENT, 30), frames=30)
    assert not cost.lost and 3 <= cost.frames <= 40


def replug(camera: ReconnectingCamera, at: Path, number: int) -> Callable[[], None]:
    """Unplugs now and plugs in again during a read."""

    def again() -> None:
        unload("vivid")
        plug(number)

    def act() -> None:
        inject(at, driver.DISCONNECT)
        threading.Thread(target=again, daemon=True).start()

    return act


def test_unplugged_and_plugged_in_again(vivid: Path, camera: ReconnectingCamera) -> None:
    cost = cost_of("unplugged, plugged in again", camera, HZ, replug(camera, vivid, 0))
    assert cost.lost


def test_plugged_in_again_under_another_number(vivid: Path) -> None:
    camera = opened(check_source("camera:vivid", CAMERA).text)
    cost = cost_of("comes back as /dev/video5", camera, HZ, replug(camera, vivid, 5))
    assert cost.lost and camera.info.name == "camera:/dev/video5"
    camera.close()


def test_a_number_follows_its_camera_too(vivid: Path, camera: ReconnectingCamera) -> None:
    cost_of("camera:0 comes back as /dev/video3", camera, HZ, replug(camera, vivid, 3))
    assert camera.info.name == "camera:/dev/video3"


def test_a_camera_that_appears_later() -> None:
    unload("vivid")
    camera = opened("camera:/dev/video0")
    out = np.empty((180, 320, 3), np.uint8)
    with pytest.raises(TimeoutError, match="no such device"):
        camera.read(out)
    threading.Timer(0.5, plug).start()
    began = time.monotonic()
    read(camera, out)
    driver.record("appears 0.5 s after the start", Cost(0, time.monotonic() - began, True))
    camera.close()
    unload("vivid")


def test_another_program_holds_the_camera(vivid: Path) -> None:
    other = subprocess.Popen(
        ("v4l2-ctl", "-d", str(vivid), "--stream-mmap", "--stream-count=0"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        time.sleep(2)
        with pytest.raises(UserError, match="busy") as told:
            check_camera(vivid, CAMERA)
        assert "fuser" in told.value.remedy
        camera = opened(f"camera:{vivid}")
        out = np.empty((180, 320, 3), np.uint8)
        with pytest.raises(TimeoutError, match="busy"):
            camera.read(out)
    finally:
        other.kill()
        other.wait()
    began = time.monotonic()
    read(camera, out)
    driver.record("held by another program, until that ends", Cost(0, time.monotonic() - began, True))
    camera.close()


def test_no_signal_is_said_and_the_picture_returns_with_it() -> None:
    """On a grabber's HDMI input: without a signal the driver delivers noise."""
    unload("vivid")
    path = plug(0, "num_inputs=1", "input_types=3")
    camera, out = opened(f"camera:{path}"), np.empty((180, 320, 3), np.uint8)
    read(camera, out)
    inject(path, driver.SIGNAL_MODE, 1)
    said: list[str] = []
    while not any("signal" in text for text in said):
        try:
            camera.read(out)
        except TimeoutError as error:  # CameraLost has the reason
            said.append(str(error))
    inject(path, driver.SIGNAL_MODE, 0)
    read(camera, out)
    camera.close()
    unload("vivid")
