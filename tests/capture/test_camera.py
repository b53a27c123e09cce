"""The camera without a camera: negotiation, notes, stamps, counting and real errors. With a real
driver: tests/camera_vm.
"""

import errno
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture import v4l2_abi as abi
from lfpipe.capture.camera import (
    MAX_AGE_NS,
    SensorClock,
    negotiate,
    stamp_kind,
)
from lfpipe.capture.camera_list import cameras
from lfpipe.capture.open_source import check_source
from lfpipe.capture.v4l2_device import FrameSizes
from lfpipe.errors import UserError
from lfpipe.transport.ring import StampKind
from tests.capture.fake_camera import PATH, FakeCamera, source
from tests.support.examples import examples

PERIOD_NS = 100_000_000
OUT = np.zeros((480, 640, 3), np.uint8)


def test_requests_are_those_of_the_kernel() -> None:
    """The sizes are part of the numbers, which were compared with linux/videodev2.h."""
    assert (abi.QUERYCAP, abi.S_FMT, abi.DQBUF, abi.S_PARM) == (
        0x80685600,
        0xC0D05605,
        0xC0585611,
        0xC0CC5616,
    )
    assert (abi.QUERYCTRL, abi.ENUM_FRAMEINTERVALS) == (0xC0445624, 0xC034564B)
    assert abi.fourcc_code("YUYV") == 0x56595559 and abi.fourcc_text(0x56595559) == "YUYV"


def listed(*modes: str) -> list[FrameSizes]:
    """Modes as in "YUYV 640x480 30 15"."""
    split = [mode.replace("x", " ").split() for mode in modes]
    return [
        FrameSizes(
            fourcc=fourcc,
            width_px=int(width),
            height_px=int(height),
            rates_hz=tuple(map(float, rates)),
        )
        for fourcc, width, height, *rates in split
    ]


@pytest.mark.parametrize(
    ("modes", "wanted", "request_"),
    [
        (["YUYV 640x480 15", "MJPG 640x480 30"], {}, ("MJPG", 640, 480, 30.0)),
        (["YUYV 640x480 30 15", "MJPG 640x480 60 30"], {"rate_hz": 60}, ("MJPG", 640, 480, 60.0)),
        (["YUYV 640x480 30", "MJPG 640x480 30"], {}, ("YUYV", 640, 480, 30.0)),
        (["YUYV 640x480 30", "MJPG 640x480 30"], {"rate_hz": 29.97}, ("YUYV", 640, 480)),
        (["YUYV 320x240 30", "MJPG 640x480 30"], {}, ("MJPG", 640, 480, 30.0)),
        (["YUYV 640x480 10", "MJPG 320x240 30"], {}, ("YUYV", 640, 480)),
        (["MJPG 1920x1080 30", "MJPG 1280x960 30", "MJPG 640x480 30"], {}, ("MJPG", 640, 480)),
        (["YUYV 160x120 30", "MJPG 1280x960 30"], {}, ("MJPG", 1280, 960)),
        (["GREY 640x480 30", "MJPG 640x480 30"], {}, ("MJPG", 640, 480)),
        (["H264 640x480 30", "NV12 640x480 30"], {}, ("NV12", 640, 480)),
        (["H264 640x480 30", "NV12 640x480 30"], {"format": "YUYV"}, ("NV12", 640, 480)),
        # a camera that lists nothing: what is usual
        ([], {"width_px": 1280, "height_px": 720}, ("MJPG", 1280, 720)),
        # an automatic rate is 60 Hz where the format has it
        (["YUYV 640x480 60 30"], {}, ("YUYV", 640, 480, 60.0)),
        (["YUYV 640x480 30", "MJPG 640x480 60 30"], {}, ("YUYV", 640, 480, 30.0)),
        (["MJPG 640x480 120 60 30"], {}, ("MJPG", 640, 480, 60.0)),
        (["MJPG 640x480 50 30", "MJPG 320x240 60"], {}, ("MJPG", 640, 480, 30.0)),
        (["YUYV 640x480 60 30"], {"rate_hz": 30.0}, ("YUYV", 640, 480, 30.0)),
    ],
)
def test_the_mode_is_chosen_by_size_rate_and_cost(
    modes: list[str], wanted: dict[str, Any], request_: tuple[object, ...]
) -> None:
    device = FakeCamera(offered=listed(*modes))
    _, info = negotiate(PATH, device, config.Camera(**wanted))
    assert device.requested[0][: len(request_)] == request_
    if device.requested[0][3] == 60.0 and not wanted:
        assert len(info.notes) == 1, "an automatic rate is never missed"


def test_lost_signal_is_reported_and_noise_is_not_shown() -> None:
    device = FakeCamera()
    camera = source(device)
    device.signal = camera._controls.signal = False
    with pytest.raises(UserError, match="no signal"):
        camera.read(OUT)


@given(
    st.integers(10**10, 10**16),
    st.integers(0, MAX_AGE_NS),
    st.none() | st.integers(0, 10**8),
    st.booleans(),
)
def test_stamps_move_to_the_middle_of_the_exposure(
    now_ns: int, age_ns: int, exposure_ns: int | None, start: bool
) -> None:
    kind = StampKind.START_OF_EXPOSURE if start else StampKind.END_OF_FRAME
    stamp_ns = now_ns - age_ns
    # an unknown exposure is half a period
    half_ns = PERIOD_NS // 4 if exposure_ns is None else exposure_ns // 2
    middle_ns = min(stamp_ns + (half_ns if start else -half_ns), now_ns)
    assert SensorClock(10.0).middle_ns(stamp_ns, kind, now_ns, exposure_ns) == (middle_ns, kind)


@given(st.lists(st.integers(0, PERIOD_NS - 1), min_size=2, max_size=20))
@examples(30)
def test_stamps_ahead_of_the_clock_by_less_than_a_frame_keep_their_spacing(
    waits_ns: list[int],
) -> None:
    """As those of vivid: for the end of a frame that is handed out before its end."""
    clock = SensorClock(10.0)
    found = []
    # the first is read at once: the largest lead there is
    for k, wait_ns in enumerate([0, *waits_ns]):
        stamp_ns = 10**12 + k * PERIOD_NS
        read_ns = stamp_ns - PERIOD_NS + wait_ns
        middle_ns, kind = clock.middle_ns(stamp_ns, StampKind.END_OF_FRAME, read_ns, 0)
        assert kind == StampKind.END_OF_FRAME and middle_ns <= read_ns, (
            "nothing is read before it was exposed"
        )
        found.append(middle_ns)
    assert set(np.diff(found)) == {PERIOD_NS}


@pytest.mark.parametrize(
    "stamp_ns", [0, 1, 1_700_000_000 * 10**9, -5, 3600 * 10**9 + 2 * PERIOD_NS]
)
def test_stamps_of_another_clock_are_refused(stamp_ns: int) -> None:
    """None, the wall clock, a wrapped one, one from further ahead than a frame."""
    now_ns = 3600 * 10**9
    assert SensorClock(10.0).middle_ns(stamp_ns, StampKind.END_OF_FRAME, now_ns, None) == (
        now_ns,
        StampKind.READ,
    )


def test_uvcvideo_stamps_the_first_packet_unless_the_camera_stamps(tmp_path: Path) -> None:
    parameter = tmp_path / "hwtimestamps"
    assert stamp_kind("uvcvideo", True, parameter) == StampKind.START_OF_TRANSFER
    parameter.write_text("1\n")
    assert stamp_kind("uvcvideo", True, parameter) == StampKind.START_OF_EXPOSURE
    assert stamp_kind("vivid", True, parameter) == StampKind.START_OF_EXPOSURE
    assert stamp_kind("uvcvideo", False, parameter) == StampKind.END_OF_FRAME


@pytest.mark.parametrize(
    ("age_s", "kind"), [(0.005, StampKind.START_OF_EXPOSURE), (1e6, StampKind.READ)]
)
def test_frames_carry_the_drivers_stamp_or_the_time_of_reading_which_is_noted(
    age_s: float, kind: StampKind
) -> None:
    device = FakeCamera()
    device.start_of_exposure = True
    device.age_s = age_s
    camera = source(device)
    frame = camera.read(OUT)
    assert any("no usable time stamps" in note for note in camera.info.notes) == (
        kind == StampKind.READ
    )
    assert (
        frame is not None and frame.stamp == kind and 0 <= frame.t_read_ns - frame.t_sensor_ns < 1e9
    )
    assert kind != StampKind.READ or frame.t_sensor_ns == frame.t_read_ns


def test_frames_that_the_driver_lost_leave_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10**12]
    monkeypatch.setattr("time.monotonic_ns", lambda: now[0])
    device = FakeCamera()
    device.sequences = [7, 8, 11, 2**32 - 1, 0, 0, 0]  # lost two; nonsense; wrapped; does not count
    camera = source(device)
    seqs = []
    for periods in (1, 3, 1, 1, 1, 1):
        now[0] += periods * 33_333_333
        frame = camera.read(OUT)
        assert frame is not None
        seqs.append(frame.source_seq)
    assert seqs == [0, 3, 4, 5, 6, 7]


@pytest.mark.parametrize("error", [TimeoutError(), OSError(errno.EBUSY, "busy")])
def test_a_camera_without_a_first_frame_is_closed(error: Exception) -> None:
    device = FakeCamera(frames=[error])
    with pytest.raises(UserError):
        source(device)
    assert device.closed


WHOLE = bytes([9, 128] * (640 * 480))
GONE = OSError(errno.ENODEV, "gone")


@pytest.mark.parametrize(
    ("frames", "flag", "read"),
    [
        # after a stall the next frame counts on
        ([TimeoutError(), WHOLE, GONE], False, ["s, 0 damaged", 0, "unplugged"]),
        # the last line is cut off: the damaged one is missing
        ([WHOLE[:-2], WHOLE, GONE], False, [1, "unplugged"]),
        # but not for ever, as the driver says or as it is
        ([WHOLE], True, ["no whole frame"]),
        ([WHOLE[:-2]], False, ["no whole frame"]),
    ],
)
def test_what_is_no_frame_is_skipped_or_reported(
    monkeypatch: pytest.MonkeyPatch,
    frames: list[bytes | Exception],
    flag: bool,
    read: list[object],
) -> None:
    monkeypatch.setattr("lfpipe.capture.frame_source.STALL_S", 0.05)
    device = FakeCamera(frames=[WHOLE, *frames])
    camera = source(device)
    device.damaged = flag
    found: list[object] = []
    for _ in read:
        try:
            frame = camera.read(OUT)
            found.append(None if frame is None else frame.source_seq)
        except (TimeoutError, UserError) as error:
            found.append(str(error))
    assert all(str(wanted) in str(one) for wanted, one in zip(read, found, strict=True)), found


@pytest.mark.native("Video4Linux")
@pytest.mark.parametrize(
    ("text", "says", "remedy"),
    [
        ("camera:/dev/video97", "/dev/video97: no such device", ""),
        ("camera:/dev/null", "/dev/null: not a camera", ""),
        ("camera:/etc/hostname", "/etc/hostname: not a camera", ""),
        ("camera:Nonesuch", "no camera with that name", "--camera demo"),
        pytest.param(
            "",
            "no camera found",
            "--camera demo",
            marks=pytest.mark.skipif(bool(cameras()), reason="one is here"),
        ),
    ],
)
def test_real_errors_of_real_paths(
    text: str, says: str, remedy: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UserError, match=says) as caught:
        check_source(text, config.Camera())
    assert caught.value.remedy and remedy in caught.value.remedy
    assert capfd.readouterr() == ("", "")
