"""Webcams in a row: bandwidth of their bus."""

import errno
import os

import pytest

from lfpipe.capture import v4l2_abi as abi
from lfpipe.capture.v4l2_device import BUFFERS, FrameSizes, Mode, S, V4L2Device
from lfpipe.errors import UserError
from tests.capture.fake_camera import FakeCamera, source

BYTES_PER_PX = {"YUYV": 2.0, "MJPG": 0.3}
SIZES = [
    FrameSizes(fourcc=fourcc, width_px=w, height_px=h, rates_hz=(30.0, 15.0))
    for fourcc in BYTES_PER_PX
    for w, h in ((640, 480), (320, 240))
]


class OnBus(FakeCamera):
    """A camera whose bus has room for so many bytes a second."""

    def __init__(self, room: float) -> None:
        super().__init__(offered=SIZES)
        self.room = room

    def configure(self, fourcc: str, width_px: int, height_px: int, rate_hz: float) -> Mode:
        super().configure(fourcc, width_px, height_px, rate_hz)
        self.mode = Mode(fourcc, width_px, height_px, 2 * width_px, rate_hz)
        return self.mode

    def start(self) -> None:
        mode = self.mode
        size = mode.width_px * mode.height_px * BYTES_PER_PX[mode.fourcc]
        if size * mode.rate_hz > self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    ("room", "wanted"),
    [
        (2e7, ("YUYV", 640, 30.0)),
        (3e6, ("MJPG", 640, 30.0)),
        (1.5e6, ("MJPG", 640, 15.0)),
        (8e5, ("MJPG", 320, 30.0)),
    ],
)
def test_camera_without_bandwidth_takes_a_mode_that_needs_less(
    room: float, wanted: tuple[str, int, float]
) -> None:
    device = OnBus(room)
    opened = source(device, format="auto" if wanted[0] == "MJPG" else "YUYV")
    assert (device.mode.fourcc, device.mode.width_px, device.mode.rate_hz) == wanted
    assert any("lacks bandwidth" in note for note in opened.info.notes) == (wanted[0] == "MJPG")
    opened.close()


def test_camera_without_any_bandwidth_names_the_bus_and_not_the_disk() -> None:
    device = OnBus(0.0)
    with pytest.raises(UserError) as refused:
        source(device)
    assert "bandwidth" in refused.value.message and "another USB port" in refused.value.remedy
    assert device.closed


class Buffers(V4L2Device):
    """A device whose driver refuses to stream so many times."""

    def __init__(self, refusals: int) -> None:
        self.fd = os.open("/dev/zero", os.O_RDWR)
        self._maps = []
        self.refusals = refusals
        self.buffers = 0

    def ioctl(self, request: int, argument: S) -> S:
        if request == abi.REQBUFS:
            assert not (argument.count and self.buffers), "as a driver: free the old ones first"
            self.buffers = argument.count
        elif request == abi.QUERYBUF:
            argument.length = 4096
        elif request == abi.STREAMON and self.refusals:
            self.refusals -= 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return argument


def test_stream_that_does_not_start_leaves_no_buffers() -> None:
    device = Buffers(1)
    with pytest.raises(OSError, match="No space"):
        device.start()
    assert device.buffers == 0
    device.start()
    assert device.buffers == BUFFERS
    device.close()
    assert device.buffers == 0
