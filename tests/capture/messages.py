"""Refusals of sources."""

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfpipe.capture.camera import trouble
from lfpipe.capture.camera_list import CameraDevice, by_name
from lfpipe.capture.open_source import check_source
from lfpipe.capture.opencv_camera import OpenCVCamera
from lfpipe.capture.spec import parse_source
from lfpipe.capture.v4l2_device import FrameSizes, Mode
from lfpipe.config import Camera
from tests.capture.fake_camera import FakeCamera, source

TWINS = [
    CameraDevice(Path(f"/dev/video{number}"), name)
    for number, name in enumerate(("Front", "Cam", "CAM"))
]
Cause = Callable[[Path], object]


def parsed(text: str) -> Cause:
    return lambda _: parse_source(text)


def checked(name: str, make: Callable[[Path], object]) -> Cause:
    def cause(here: Path) -> None:
        make(here / name)
        check_source(f"file:{here / name}", Camera())

    return cause


def failing(number: int) -> Cause:
    def cause(_: Path) -> None:
        raise trouble(Path("/dev/video7"), OSError(number, os.strerror(number)))

    return cause


def camera(signal: bool = True, **how: Any) -> Cause:
    def cause(_: Path) -> None:
        device = FakeCamera(**{"offered": ("YUYV",), **how})
        device.signal = signal
        source(device)

    return cause


MESSAGES: dict[str, tuple[Cause, str]] = {
    "no scheme": (
        parsed("fiel:a.mp4"),
        "'fiel:a.mp4': not a frame source … camera:N, … file:PATH?loop=0|1 … demo",
    ),
    "no camera given": (parsed("camera: "), "'camera: ': not a frame source … camera:NAME"),
    "no path": (parsed("file:?loop=0"), "file: has no path … file:walk.mp4"),
    "bad pace": (
        parsed("file:a?pace=nan"),
        "unknown option 'pace=nan' in 'file:a … pace=recorded|max|HZ … 10000 … another '?'",
    ),
    "no file": (
        checked("a.avi", lambda path: None),
        "/here/a.avi: no such file … relative to the current directory",
    ),
    "text": (
        checked("a.avi", lambda path: path.write_text("text")),
        "/here/a.avi: not a readable video … QuickTime … another program",
    ),
    "damaged picture": (
        checked("a.png", lambda path: path.write_text("text")),
        "/here/a.png: not a readable picture … remove it from the folder",
    ),
    "empty folder": (
        checked("a", Path.mkdir),
        "/here/a: the folder has no pictures … .png … or a video in it",
    ),
    "unplugged": (failing(errno.ENODEV), "camera /dev/video7: unplugged … plug it in again"),
    "no permission": (failing(errno.EACCES), "camera /dev/video7: no permission … group `video`"),
    "forbidden": (
        failing(errno.EPERM),
        "camera /dev/video7: the system forbids it … `--device /dev/video7`",
    ),
    "busy": (failing(errno.EBUSY), "camera /dev/video7: busy … `fuser -v /dev/video7`"),
    "full bus": (
        failing(errno.ENOSPC),
        "camera /dev/video7: the USB bus lacks bandwidth … camera.format=MJPG … camera.width_px",
    ),
    "silent driver": (
        failing(errno.ETIMEDOUT),
        "camera /dev/video7: its driver does not answer … plug it in again",
    ),
    "other failure": (
        failing(errno.EIO),
        "camera /dev/video7: its driver failed (Input/output error) … plug it in again",
    ),
    "no signal": (camera(signal=False), "camera /dev/null: no signal at its input … switch it on"),
    "no picture": (
        camera(frames=[TimeoutError()]),
        "camera /dev/null: no picture for 5 s … plug it in again",
    ),
    "unknown formats": (
        camera(offered=["H264", "HSV3"]),
        "camera /dev/null: none … decoded (H264, HSV3) … MJPG, JPEG, YUYV",
    ),
    "another format": (
        camera(
            offered=[FrameSizes(fourcc="YUYV", width_px=640, height_px=480)],
            mode=Mode("H264", 640, 480, 0, 30.0),
        ),
        "camera /dev/null: none … can be decoded (H264) … MJPG, JPEG, YUYV",
    ),
    "impossible rows": (
        camera(mode=Mode("YUYV", 640, 480, 1279, 30.0)),
        "camera /dev/null: YUYV of 640 px with 1279 bytes … camera.format",
    ),
    "two of a name": (
        lambda _: by_name("cam", TWINS),
        "camera:cam: 2 cameras … camera:/dev/video1 or camera:/dev/video2",
    ),
    "no number": (
        lambda _: OpenCVCamera(Path("/dev/front"), Camera()),
        "camera /dev/front: not the number … camera:0",
    ),
}
