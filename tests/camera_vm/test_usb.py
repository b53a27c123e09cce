"""The kernel's uvcvideo with a USB camera in software: modes, damage, slow controls, replugging,
and a face from end to end.
"""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.camera import check_camera, open_camera
from lfpipe.capture.camera_list import CameraFinder
from lfpipe.capture.demo import DemoSource
from lfpipe.capture.spec import CameraSpec
from lfpipe.errors import UserError
from tests.camera_vm import driver
from tests.camera_vm.usb_camera import AE_PRIORITY, Frames, UsbCamera
from tests.support.world import until

pytestmark = [pytest.mark.camera_vm, pytest.mark.timeout(480)]
SIZE = (320, 240)
MODES = (Frames("YUYV", *SIZE, (5.0,)), Frames("MJPG", *SIZE, (10.0, 5.0)))
CAMERA = config.Camera(width_px=SIZE[0], height_px=SIZE[1], rate_hz=10.0)
MOVED_VIEWS = 0.03  # of the grid's one view from left to right
Plug = Callable[..., UsbCamera]


def jpegs(count: int) -> list[bytes]:
    """Frames of the demo's viewer, 10 per second of their path."""
    source = DemoSource(CAMERA)
    out = np.empty((SIZE[1], SIZE[0], 3), np.uint8)
    frames = []
    for _ in range(count):
        source.read(out)
        frames.append(cv2.imencode(".jpg", out)[1].tobytes())
    return frames


FRAMES = jpegs(40)


def face(mode: Frames, number: int) -> bytes:
    """The demo's viewer to and fro."""
    if mode.fourcc == "YUYV":
        return bytes(2 * SIZE[0] * SIZE[1])
    at = number % (2 * len(FRAMES))
    return FRAMES[min(at, 2 * len(FRAMES) - 1 - at)]


@pytest.fixture
def plug() -> Iterator[Plug]:
    """Plugs cameras in; each waits for its device."""
    driver.load("vhci-hcd")
    driver.load("uvcvideo")
    plugged: list[UsbCamera] = []

    def add(port: int = 0, camera: UsbCamera | None = None) -> UsbCamera:
        count = len(list(Path("/sys/class/video4linux").glob("video*")))
        camera = camera or UsbCamera(MODES, face)
        camera.plug(port)
        pictures_and_metadata = count + 2
        until(lambda: len(list(Path("/dev").glob("video*"))) >= pictures_and_metadata, "camera", 30)
        plugged.append(camera)
        return camera

    yield add
    for camera in plugged:
        unplug(camera)


def unplug(camera: UsbCamera) -> None:
    before = set(Path("/dev").glob("video*"))
    camera.unplug()
    with contextlib.suppress(AssertionError):  # a test may have unplugged it
        until(lambda: not before or set(Path("/dev").glob("video*")) != before, "change", 10)


def test_the_rate_decides_between_formats_and_damaged_frames_are_none(plug: Plug) -> None:
    usb = plug()
    out = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    assert check_camera(Path("/dev/video0"), CAMERA).rate_hz == 10.0
    with contextlib.closing(open_camera(Path("/dev/video0"), CAMERA)) as camera:
        assert camera.info.jpeg and any(
            "dynamic frame rate switched off" in note for note in camera.info.notes
        )
        assert usb.controls[AE_PRIORITY].value == 0
        # every other one lacks more than its end
        usb.frame = lambda _, number: FRAMES[0][: -2 if number % 2 else -900]
        first = [camera.read(out) for _ in range(6)]
        numbers = [frame.source_seq for frame in first[2:] if frame is not None]
        assert np.diff(numbers).min() >= 2, "the damaged ones are missing"
        np.testing.assert_array_equal(
            out, cv2.imdecode(np.frombuffer(FRAMES[0], np.uint8), cv2.IMREAD_COLOR)
        )
    # the camera does not wait for its controls
    until(lambda: usb.controls[AE_PRIORITY].value == 1, "restored control")


def test_a_slow_control_stops_no_frame(plug: Plug) -> None:
    usb = plug()
    usb.slow_s = 1.0
    out = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    with contextlib.closing(open_camera(Path("/dev/video0"), CAMERA)) as camera:
        for _ in range(40):
            assert camera.read(out) is not None
        usb.slow_s = 0.0


def test_a_camera_returns_whatever_its_number_and_a_twin_stays_out(plug: Plug) -> None:
    usb, twin = plug(0), plug(1)
    finder = CameraFinder(CameraSpec(Path("/dev/video0")))
    assert finder.path() == Path("/dev/video0")
    unplug(usb)
    for _ in range(2):
        with pytest.raises(UserError, match="unplugged"):
            finder.path()
    taken = plug(2)  # takes /dev/video0 and 1
    plug(0, usb)
    again = finder.path()
    assert again != Path("/dev/video0")
    with contextlib.closing(open_camera(again, CAMERA)) as camera:
        assert camera.read(np.zeros((SIZE[1], SIZE[0], 3), np.uint8)) is not None
    assert usb.sent > 0 and twin.sent == taken.sent == 0


def test_a_face_seen_through_it_moves_the_picture(plug: Plug, tmp_path: Path) -> None:
    """However slowly the machine is emulated: waits until the view has moved, and frames are as few
    as a loaded one tracks.
    """
    # a brisk head
    plug(
        0, UsbCamera([Frames("MJPG", *SIZE, (1.0,))], lambda _, number: face(MODES[1], 4 * number))
    )
    scene, trace = tmp_path / "scene", tmp_path / "t.jsonl"
    scene.mkdir()
    rng = np.random.default_rng(1)
    base = cv2.GaussianBlur(rng.integers(0, 256, (48, 76, 3), dtype=np.uint8), (0, 0), 2)
    for name, left in (("view_00_00", 4), ("view_00_01", 0), ("view_01_00", 4), ("view_01_01", 0)):
        cv2.imwrite(str(scene / f"{name}.png"), base[:, left : left + 72])
    pack = [sys.executable, "-m", "lfpipe", "scene", "pack", str(scene)]
    # packed beforehand: a child without a step for a minute is ended, and so are its imports here
    for _ in range(3):
        if subprocess.run(pack, env={"HOME": "/root"}, check=False).returncode == 0:
            break
    sets = (
        "camera.width_px=320",
        "camera.height_px=240",
        "camera.rate_hz=1",
        "render.method=blend",
        "render.clock=camera",
    )
    words = [
        sys.executable,
        "-m",
        "lfpipe",
        "up",
        str(scene),
        "--display",
        "none",
        "--trace",
        str(trace),
    ]
    words += [
        "--camera",
        "camera:/dev/video0",
        *(word for text in (*sets, "governor.quality=fixed") for word in ("--set", text)),
    ]
    process = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={"HOME": "/root"}
    )
    columns: list[float] = []
    until = time.monotonic() + 380
    while (
        np.ptp(columns or [0.0]) <= MOVED_VIEWS
        and process.poll() is None
        and time.monotonic() < until
    ):
        time.sleep(1)
        lines = trace.read_text().splitlines() if trace.exists() else []
        rows = [json.loads(line) for line in lines if line.endswith("}")]
        columns = [row["view"]["left"][1] for row in rows if row["face"]]
    process.terminate()
    output, _ = process.communicate(timeout=60)
    print(output)
    if "no beat for" in output and "TCG" in Path("/proc/cpuinfo").read_text():
        pytest.skip("emulated: one frame computes for longer than a stage may")
    assert np.ptp(columns or [0.0]) > MOVED_VIEWS, (columns, output)
