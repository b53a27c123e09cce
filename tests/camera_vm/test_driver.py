"""The product's camera on the real driver: formats, rounding, stamps, controls."""

import contextlib
from pathlib import Path
from typing import cast

import attrs
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.camera import CameraSource, check_camera, open_camera
from lfpipe.capture.camera_list import asking
from lfpipe.capture.frame_source import Frame
from lfpipe.capture.v4l2_device import DECODED
from lfpipe.config.tree import PixelFormat
from lfpipe.transport.ring import StampKind
from tests.camera_vm import driver

pytestmark = pytest.mark.camera_vm
SMALL = config.Camera(width_px=320, height_px=180, rate_hz=10.0)


def frames(source: CameraSource, count: int) -> tuple[np.ndarray, list[Frame]]:
    out = np.zeros((180, 320, 3), np.uint8)
    try:
        found = [source.read(out) for _ in range(count)]
    finally:
        source.close()
    return out, [frame for frame in found if frame is not None]


def test_every_format_that_can_be_decoded_gives_the_same_picture(vivid: Path) -> None:
    reference, _ = frames(open_camera(vivid, attrs.evolve(SMALL, format="BGR3")), 1)
    rec_709 = reference @ np.array([0.0722, 0.7152, 0.2126])
    grey = np.repeat(rec_709[..., None], 3, axis=2)
    offered = asking(vivid, lambda device: device.fourccs())
    tried = [fourcc for fourcc in offered if fourcc in DECODED]
    assert {"YUYV", "NV12", "GREY", "RGGB"} <= set(tried)
    wrong = {}
    for fourcc in tried:
        source = open_camera(vivid, attrs.evolve(SMALL, format=cast(PixelFormat, fourcc)))
        assert f"delivers {fourcc} 320x180 at 10 Hz" in source.info.notes[0]
        picture, _ = frames(source, 1)
        eye_distance = np.abs(picture.astype(int) - (grey if fourcc == "GREY" else reference))
        if (
            np.median(eye_distance) > 4 or np.quantile(eye_distance, 0.9) > 24
        ):  # edges of the bars, limited range
            wrong[fourcc] = (float(np.median(eye_distance)), float(np.quantile(eye_distance, 0.9)))
    assert not wrong


def test_a_format_that_cannot_be_decoded_gives_way(vivid: Path) -> None:
    source = open_camera(vivid, attrs.evolve(SMALL, format="HSV3"))  # type: ignore[arg-type]
    assert any("HSV3 requested" in note for note in source.info.notes)
    assert len(frames(source, 2)[1]) == 2


def test_rounded_sizes_and_rates_are_noted(vivid: Path) -> None:
    wanted = config.Camera(width_px=700, height_px=500, rate_hz=33.0)
    out = np.zeros((500, 700, 3), np.uint8)
    with contextlib.closing(open_camera(vivid, wanted)) as source:
        info = source.info
        assert source.read(out) is not None and out.any()
    said = " ".join(info.notes)
    assert info.size_px != (700, 500) and "scaled to" in said and "33 Hz requested" in said
    assert check_camera(vivid, wanted).rate_hz == info.rate_hz


@pytest.mark.parametrize(
    ("value", "kind"), [(0, StampKind.END_OF_FRAME), (1, StampKind.START_OF_EXPOSURE)]
)
def test_both_kinds_of_stamp_are_used_although_they_are_ahead(
    vivid: Path, value: int, kind: StampKind
) -> None:
    driver.inject(vivid, driver.TIMESTAMP_SOURCE, value)
    source = open_camera(vivid, SMALL)
    _, found = frames(source, 12)
    assert not any("time stamps" in note for note in source.info.notes)
    assert {frame.stamp for frame in found} == {kind}
    assert all(frame.t_sensor_ns <= frame.t_read_ns for frame in found)
    steps_ms = np.diff([frame.t_sensor_ns / 1e6 for frame in found]) / np.diff(
        [frame.source_seq for frame in found]
    )
    assert abs(float(np.median(steps_ms)) - 100) < 5
