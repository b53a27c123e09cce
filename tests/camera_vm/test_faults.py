"""Each fault of the driver: the picture returns, and its cost is bounded."""

import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.camera import check_camera
from lfpipe.capture.open_source import ReconnectingCamera, check_source, open_source
from lfpipe.errors import UserError
from tests.camera_vm import driver
from tests.camera_vm.driver import after, inject, plug, read, unload
from tests.support.world import until

pytestmark = pytest.mark.camera_vm
CAMERA = config.Camera(width_px=320, height_px=180, rate_hz=10.0)
HZ = 10.0
OUT = np.empty((180, 320, 3), np.uint8)


def opened(text: str) -> ReconnectingCamera:
    source = open_source(text, CAMERA, reconnect=True)
    assert isinstance(source, ReconnectingCamera)
    return source


@pytest.fixture
def camera(vivid: Path) -> Iterator[ReconnectingCamera]:
    made = opened(f"camera:{vivid}")
    yield made
    made.close()


@pytest.mark.parametrize(
    ("control", "most"),
    [
        pytest.param(driver.BUFFER_ERROR, 1, id="damaged buffer"),
        pytest.param(driver.QBUF_ERROR, None, id="QBUF fails once"),  # reconnects
        pytest.param(driver.FATAL_ERROR, None, id="fatal streaming error"),
    ],
)
def test_a_fault_while_streaming(
    vivid: Path, camera: ReconnectingCamera, control: int, most: int | None
) -> None:
    missing, lost = after(lambda: inject(vivid, control), camera, HZ)
    assert lost == (most is None)
    if most is not None:
        assert most <= missing <= most + 2  # the guest itself may be late once


@pytest.mark.parametrize(
    "control", [driver.REQBUFS_ERROR, driver.STREAMON_ERROR], ids=["REQBUFS", "STREAMON"]
)
def test_after_a_fault_at_the_start_the_camera_is_opened_again(vivid: Path, control: int) -> None:
    inject(vivid, control)
    with closing(opened(f"camera:{vivid}")) as camera:
        assert read(camera, OUT)[1]


def test_frames_that_the_driver_drops_are_counted(vivid: Path, camera: ReconnectingCamera) -> None:
    missing, lost = after(lambda: inject(vivid, driver.DROPPED_PERCENT, 30), camera, HZ, frames=30)
    assert not lost and 3 <= missing <= 40


def replug(at: Path, number: int) -> Callable[[], None]:
    """Unplugs now and plugs in again during a read."""

    def again() -> None:
        unload("vivid")
        plug(number)

    def act() -> None:
        inject(at, driver.DISCONNECT)
        threading.Thread(target=again, daemon=True).start()

    return act


@pytest.mark.parametrize(
    ("text", "number"),
    [("camera:/dev/video0", 0), ("camera:/dev/video0", 3), ("camera:vivid", 5)],
    ids=["same_number", "other_number", "by_name"],
)
def test_unplugged_and_plugged_in_again(vivid: Path, text: str, number: int) -> None:
    with closing(opened(check_source(text, CAMERA).source)) as camera:
        assert after(replug(vivid, number), camera, HZ)[1]
        assert camera.info.name == f"camera:/dev/video{number}"


def test_a_camera_that_appears_later() -> None:
    unload("vivid")
    with closing(opened("camera:/dev/video0")) as camera:
        with pytest.raises(TimeoutError, match="no such device"):
            camera.read(OUT)
        threading.Timer(0.5, plug).start()
        read(camera, OUT)
    unload("vivid")


def test_another_program_holds_the_camera(vivid: Path) -> None:
    words = ("v4l2-ctl", "-d", str(vivid), "--stream-mmap", "--stream-count=0")
    other = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        files = Path(f"/proc/{other.pid}/fd")
        until(lambda: vivid.resolve() in map(Path.resolve, files.glob("*")), "stream", 20)
        with pytest.raises(UserError, match="busy") as refusal:
            check_camera(vivid, CAMERA)
        assert "fuser" in refusal.value.remedy
        camera = opened(f"camera:{vivid}")
        with pytest.raises(TimeoutError, match="busy"):
            camera.read(OUT)
    finally:
        other.kill()
        other.wait(60)
    read(camera, OUT)
    camera.close()


def test_lost_signal_is_reported_and_the_picture_returns() -> None:
    """On a grabber's HDMI input: without a signal the driver delivers noise."""
    unload("vivid")
    path = plug(0, "num_inputs=1", "input_types=3")
    with closing(opened(f"camera:{path}")) as camera:
        read(camera, OUT)
        inject(path, driver.SIGNAL_MODE, 1)
        reasons: list[str] = []
        while not any("signal" in reason for reason in reasons):
            try:
                camera.read(OUT)
            except TimeoutError as error:  # CameraLost has the reason
                reasons.append(str(error))
        inject(path, driver.SIGNAL_MODE, 0)
        read(camera, OUT)
    unload("vivid")
