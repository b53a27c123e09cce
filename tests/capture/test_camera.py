"""What can be shown of the camera without one: what is asked for, what is made of the answers, and real errors."""

import struct
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.camera import MAX_STAMP_AGE_NS, CameraSource, configure, fourcc_text, pixel_format, sensor_stamp_ns
from lfpipe.capture.open_source import check_source
from lfpipe.capture.v4l2 import CAP_DEVICE_CAPS, CAP_VIDEO_CAPTURE, QUERYCAP_BYTES, cameras, captures
from lfpipe.errors import UserError


class Rounding:
    """A driver that, as real ones do, takes what it has instead of what it is asked for, and stamps with a given clock."""

    def __init__(
        self, size: tuple[int, int] = (640, 480), rate: float = 30.0, code: str = "YUYV", grabs: tuple[bool, ...] = ()
    ) -> None:
        self.asked: list[int] = []
        self.answers = {
            cv2.CAP_PROP_FRAME_WIDTH: float(size[0]),
            cv2.CAP_PROP_FRAME_HEIGHT: float(size[1]),
            cv2.CAP_PROP_FPS: rate,
            cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*code)),
        }
        self.size, self.grabs, self.age_ms, self.released = size, list(grabs), 5.0, False

    def set(self, propId: int, value: float) -> bool:
        self.asked.append(propId)
        return True

    def get(self, propId: int) -> float:
        return time.monotonic_ns() / 1e6 - self.age_ms if propId == cv2.CAP_PROP_POS_MSEC else self.answers[propId]

    def grab(self) -> bool:
        return self.grabs.pop(0) if self.grabs else True

    def retrieve(self, image: Any = None) -> tuple[bool, Any]:
        image[:] = 9
        return True, image

    def release(self) -> None:
        self.released = True


def test_format_is_asked_first_and_read_back() -> None:
    device = Rounding((800, 600), 15.0, "MJPG")
    width, height, rate, notes = configure(device, config.Camera())
    assert device.asked[0] == cv2.CAP_PROP_FOURCC
    assert (width, height, rate) == (800, 600, 15.0)
    said = " ".join(notes)
    for part in ("MJPG 800x600 at 15 Hz", "YUYV was asked for", "scaled to 640x480", "30 Hz were asked for"):
        assert part in said


def test_a_camera_that_does_as_asked_needs_one_note() -> None:
    assert configure(Rounding(), config.Camera())[3] == ("the camera gives YUYV 640x480 at 30 Hz",)


def test_an_unknown_rate_is_the_one_asked_for() -> None:
    assert configure(Rounding(rate=0.0), config.Camera(rate_hz=25.0))[2] == 25.0


def test_pixel_format() -> None:
    assert pixel_format(config.Camera()) == "YUYV"
    assert pixel_format(config.Camera(width_px=1280, height_px=720)) == "MJPG"
    assert pixel_format(config.Camera(format="MJPG")) == "MJPG"


@given(st.text(st.characters(min_codepoint=65, max_codepoint=90), min_size=4, max_size=4))
def test_fourcc_round_trip(code: str) -> None:
    assert fourcc_text(float(cv2.VideoWriter.fourcc(*code))) == code


@pytest.mark.parametrize("value", [0.0, -1.0, 1e12])
def test_fourcc_that_tells_nothing(value: float) -> None:
    assert fourcc_text(value) == "?"


@given(st.integers(10**9, 10**16), st.integers(0, MAX_STAMP_AGE_NS // 1000))
def test_kernel_stamps_survive_to_the_microsecond(now_us: int, age_us: int) -> None:
    now_ns, stamp_us = now_us * 1000, max(1, now_us - age_us)
    position_ms = 1000.0 * (stamp_us // 10**6) + (stamp_us % 10**6) / 1000.0  # as the capture makes it of a timeval
    if now_us < 2**52 and now_us - age_us > 0:
        assert sensor_stamp_ns(position_ms, now_ns) == stamp_us * 1000


@pytest.mark.parametrize("position_ms", [0.0, -1.0, float("nan"), float("inf"), 1.7e12, 1.0])
def test_stamps_of_another_clock_are_refused(position_ms: float) -> None:
    """None, the wall clock, and a stamp from just after the start of a machine that has run for an hour."""
    assert sensor_stamp_ns(position_ms, 3600 * 10**9) is None


def test_stamp_from_the_future_is_refused() -> None:
    assert sensor_stamp_ns(2001.0, 2000 * 10**6) is None


def test_frames_carry_the_kernels_stamp() -> None:
    source = CameraSource(Path("/dev/null"), config.Camera(), Rounding())
    out = np.zeros((480, 640, 3), np.uint8)
    frames = [source.read(out) for _ in range(3)]
    assert [frame.source_seq for frame in frames] == [0, 1, 2]
    assert all(4e6 < frame.t_read_ns - frame.t_sensor_ns < 1e9 for frame in frames)
    assert (out == 9).all()


def test_without_stamps_the_frame_is_stamped_when_taken_and_that_is_said() -> None:
    device = Rounding((320, 240))
    device.age_ms = -1e9
    source = CameraSource(Path("/dev/null"), config.Camera(), device)
    assert any("no usable time stamps" in note for note in source.info.notes)
    out = np.zeros((480, 640, 3), np.uint8)
    frame = source.read(out)
    assert frame.t_sensor_ns == frame.t_read_ns
    assert (out == 9).all()  # scaled from 320x240


def test_a_failing_grab_is_a_camera_that_is_gone() -> None:
    source = CameraSource(Path("/dev/null"), config.Camera(), Rounding(grabs=(True, False)))
    with pytest.raises(UserError, match="gone"):
        source.read(np.zeros((480, 640, 3), np.uint8))


def test_a_slow_failure_is_a_stall() -> None:
    class Slow(Rounding):
        def grab(self) -> bool:
            if self.grabs and not self.grabs[0]:
                time.sleep(0.95)
            return super().grab()

    source = CameraSource(Path("/dev/null"), config.Camera(), Slow(grabs=(True, False, True)))
    out = np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(TimeoutError):
        source.read(out)
    assert source.read(out).source_seq == 0


def test_no_first_frame_is_a_busy_camera_and_lets_go_of_it() -> None:
    device = Rounding(grabs=(False,) * 5)
    with pytest.raises(UserError, match="busy"):
        CameraSource(Path("/dev/null"), config.Camera(), device)
    assert device.released


@pytest.mark.parametrize(
    ("path", "says"), [("/dev/video97", "no such device"), ("/dev/null", "not a camera"), ("/etc/hostname", "not a camera")]
)
def test_real_errors_of_real_paths(path: str, says: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UserError, match=says) as told:
        check_source(f"camera:{path}", config.Camera())
    assert path in told.value.message and told.value.remedy
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(bool(cameras()), reason="a camera is here")
def test_no_camera_at_all_names_the_ways_out() -> None:
    with pytest.raises(UserError, match="no camera found") as told:
        check_source("", config.Camera())
    assert "--camera demo" in told.value.remedy and "file:" in told.value.remedy


@given(st.integers(0, 2**31 - 1), st.integers(0, 2**32 - 1), st.booleans())
def test_the_nodes_own_capabilities_decide(whole: int, node: int, tells: bool) -> None:
    reply = bytearray(QUERYCAP_BYTES)
    struct.pack_into("=II", reply, 84, whole | (CAP_DEVICE_CAPS if tells else 0), node)
    assert captures(bytes(reply)) == bool((node if tells else whole) & CAP_VIDEO_CAPTURE)


def test_only_devices_that_exist_are_listed(tmp_path: Path) -> None:
    sys, dev = tmp_path / "sys", tmp_path / "dev"
    dev.mkdir()
    for name in ("video10", "video2"):
        (sys / name).mkdir(parents=True)
        (sys / name / "name").write_text(f"Camera {name}\n")
    assert cameras(sys, dev) == []
    for name in ("video10", "video2"):  # there, but no driver answers: listed, for the person to see what is wrong with it
        (dev / name).touch()
    found = [(camera.path.name, camera.name) for camera in cameras(sys, dev)]
    assert found == [("video2", "Camera video2"), ("video10", "Camera video10")]
