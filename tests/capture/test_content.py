"""What frames show, and which camera is used first."""

from pathlib import Path

import numpy as np
import pytest

from lfpipe.capture.camera_list import (
    GREY_ONLY,
    UNDECODABLE,
    UNKNOWN,
    CameraDevice,
    ranked,
)
from lfpipe.capture.stage import COVERED_NS, flat_since
from lfpipe.transport.ring import SECOND_NS

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
    since_ns = 0
    for k in range(1, 60):
        since_ns = flat_since(since_ns, noisy(level, sigma), k * FRAME_NS)
        assert since_ns == covered * FRAME_NS, "the first of them"
    assert COVERED_NS < 2 * SECOND_NS
    assert flat_since(since_ns, noisy(120, 50), 60 * FRAME_NS) == 0


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
    best_first = ranked(devices, lambda device: by_path[device.path])
    assert best_first == [(devices[k], doubt) for k, doubt in zip(order, doubts, strict=True)]
