"""What frames show, and which camera is used first."""

import errno
from pathlib import Path

import numpy as np
import pytest

from lfpipe.capture import camera_list
from lfpipe.capture.camera_list import (
    BLANK,
    GREY_ONLY,
    NO_FRAME,
    UNDECODABLE,
    UNKNOWN,
    CameraDevice,
    ranked,
)
from lfpipe.capture.content import COVERED_NS, ContentWatch
from lfpipe.capture.spec import CameraSpec, parse_source
from lfpipe.errors import UserError
from lfpipe.transport.clock import SECOND_NS
from tests.capture.fake_camera import FakeCamera

FRAME_NS = SECOND_NS // 30
RNG = np.random.default_rng(1)


def noisy(level: float, sigma: float) -> np.ndarray:
    frame = np.full((240, 320, 3), level) + RNG.normal(0, sigma, (240, 320, 3))
    return np.clip(frame, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("level", "sigma", "covered"),
    [
        (2, 1.5, True),
        (0, 0, True),
        (255, 0, True),
        (128, 1, True),
        (40, 9, False),
        (120, 50, False),
    ],
)
def test_frames_that_show_nothing_are_noticed_within_two_seconds(
    level: float, sigma: float, covered: bool
) -> None:
    watch = ContentWatch()
    for k in range(30):
        watch.add(noisy(120, 50), k * FRAME_NS)
    assert not watch.covered
    seen = []
    for k in range(30, 90):
        watch.add(noisy(level, sigma), k * FRAME_NS)
        seen.append(watch.covered)
    assert any(seen) == covered and COVERED_NS < 2 * SECOND_NS
    watch.add(noisy(120, 50), 90 * FRAME_NS)
    assert not watch.covered


def test_a_light_that_flashes_is_told_from_one_that_changes() -> None:
    flashing, slow = ContentWatch(), ContentWatch()
    for k in range(40):
        flashing.add(noisy(90 if k % 2 else 30, 20), k * FRAME_NS)
        slow.add(noisy(90 if k % 20 < 10 else 30, 20), k * FRAME_NS)
        assert not slow.flashes
    assert flashing.flashes


@pytest.mark.parametrize(
    ("formats", "order", "doubts"),
    [
        # a laptop's face login comes first
        ((["GREY"], ["MJPG", "YUYV"]), [1, 0], ["", GREY_ONLY]),
        ((["YUYV"], ["MJPG"]), [0, 1], ["", ""]),
        # depth camera, busy camera, webcam
        ((["Z16 "], None, ["NV12"]), [2, 1, 0], ["", UNKNOWN, UNDECODABLE]),
        (([], ["GREY", "YUYV"]), [1, 0], ["", UNKNOWN]),
        ((["GREY"],), [0], [GREY_ONLY]),
        ((), [], []),
    ],
)
def test_ranked_takes_the_camera_that_sees_faces_best(
    formats: tuple[list[str] | None, ...], order: list[int], doubts: list[str]
) -> None:
    devices = [CameraDevice(Path(f"/dev/video{k}")) for k in range(len(formats))]
    by_path = {device.path: given for device, given in zip(devices, formats, strict=True)}
    found = ranked(devices, lambda device: by_path[device.path], lambda _: "")
    assert [devices.index(one.device) for one in found] == order
    assert [one.doubt for one in found] == doubts


SIZE = (480, 640)
SCENE = np.linspace(16, 235, 640).astype(np.uint8)


def yuyv(luma: int | np.ndarray, chroma: int) -> bytes:
    frame = np.full((*SIZE, 2), chroma, np.uint8)
    frame[..., 0] = luma
    return frame.tobytes()


DARK, COLOUR, GREY = yuyv(16, 128), yuyv(SCENE, 90), yuyv(SCENE, 128)
BUSY, SILENT = OSError(errno.EBUSY, "busy"), TimeoutError("no frame")


@pytest.mark.native("Video4Linux")
@pytest.mark.parametrize(
    ("frames", "order", "doubts", "started"),
    [
        # what each camera delivers; cameras behind the first good one stay off
        (([COLOUR], [COLOUR]), [0, 1], ["", ""], 1),
        (([DARK], [COLOUR], [DARK]), [1, 2, 0], ["", "", BLANK], 2),
        (([DARK, DARK, COLOUR], [COLOUR]), [0, 1], ["", ""], 1),  # its exposure settles
        (([BUSY], [SILENT], [COLOUR]), [2, 0, 1], ["", NO_FRAME, NO_FRAME], 3),
        (([GREY], [COLOUR]), [1, 0], ["", GREY_ONLY], 2),  # infrared, in a format with colours
        (([GREY], [DARK], [BUSY]), [1, 2, 0], [BLANK, NO_FRAME, GREY_ONLY], 3),
        (([DARK],), [0], [""], 0),  # no choice
        (([], [DARK]), [1, 0], ["", GREY_ONLY], 0),  # [] has another format: decided by that
    ],
)
def test_first_frames_decide_between_cameras_of_equal_formats(
    monkeypatch: pytest.MonkeyPatch,
    frames: tuple[list[bytes | Exception], ...],
    order: list[int],
    doubts: list[str],
    started: int,
) -> None:
    monkeypatch.setattr(camera_list, "FRAMES_S", 0.1)
    made: list[FakeCamera] = []

    def opened(path: Path) -> FakeCamera:
        own = frames[int(path.name.removeprefix("video"))]
        made.append(FakeCamera(frames=own, offered=["YUYV"] if own else ["GREY"]))
        return made[-1]

    monkeypatch.setattr(camera_list, "V4L2Device", opened)
    devices = [CameraDevice(Path(f"/dev/video{k}")) for k in range(len(frames))]
    found = ranked(devices)
    assert [devices.index(one.device) for one in found] == order
    assert [one.doubt for one in found] == doubts
    assert len([device for device in made if device.requested]) == started
    assert all(device.closed for device in made)


def test_names_that_people_type_are_understood() -> None:
    assert parse_source("0") == parse_source("/dev/video0") == CameraSpec(Path("/dev/video0"))
    for address in ("rtsp://me:secret@10.0.0.7/stream", "http://cam.local:8080/video"):
        with pytest.raises(UserError, match="v4l2loopback") as refused:
            parse_source(address)
        assert "secret" not in str(refused.value)
