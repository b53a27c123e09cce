"""Cameras through OpenCV, with a fake one: the portable host uses them without Video4Linux."""

from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture import camera_list, open_source, spec
from lfpipe.capture.camera_list import CameraDevice
from lfpipe.errors import UserError
from lfpipe.transport.ring import StampKind


def capture(number: int) -> Mock:
    """As cv2.VideoCapture: camera 1 gives three frames of 80x60."""
    frames = [(True, np.full((60, 80, 3), 7, np.uint8))] * 3 if number == 1 else []
    return Mock(
        isOpened=lambda: bool(frames),
        get=lambda key: 25.0 if key == cv2.CAP_PROP_FPS else 0.0,
        read=lambda: frames.pop() if frames else (False, None),
    )


@pytest.fixture(autouse=True)
def portable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", capture)
    listed = [
        CameraDevice(Path(f"/dev/video{n}"), name)
        for n, name in enumerate(("Front", "Back", "Back two"))
    ]
    monkeypatch.setattr(camera_list, "nodes", lambda *_: listed)
    for module in (camera_list, spec):
        monkeypatch.setattr(module, "PORTABLE", True)


def test_a_camera_of_that_name_gives_frames_that_are_scaled_counted_and_stamped_when_read() -> None:
    camera = open_source.open_source("camera:back", config.Camera())
    out = np.zeros((480, 640, 3), np.uint8)
    frames = [camera.read(out) for _ in range(2)]
    assert [frame and (frame.source_seq, frame.stamp) for frame in frames] == [
        (0, StampKind.READ),
        (1, StampKind.READ),
    ]
    assert (
        (out == 7).all()
        and camera.info.rate_hz == 25.0
        and camera.info.name == "camera:/dev/video1"
    )
    with pytest.raises(UserError, match="no more pictures"):
        camera.read(out)


@pytest.mark.parametrize(
    ("text", "message", "remedy"),
    [
        ("camera:nothing", "no camera with that name", "camera:/dev/video0 (Front)"),
        ("camera:ack", "2 cameras have", "use camera:/dev/video1 or"),
        ("", "camera 0: cannot be opened", "privacy"),
    ],
)
def test_unusable_camera_is_refused_with_a_remedy(text: str, message: str, remedy: str) -> None:
    with pytest.raises(UserError, match=message) as error:
        open_source.check_source(text, config.Camera())
    assert remedy in error.value.remedy
