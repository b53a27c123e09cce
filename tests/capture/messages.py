"""Refusals of sources."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

from lfpipe.capture.camera import trouble
from lfpipe.capture.camera_list import CameraDevice, by_name
from lfpipe.capture.open_source import check_source
from lfpipe.capture.opencv_camera import OpenCVCamera
from lfpipe.capture.spec import parse_source
from lfpipe.capture.v4l2_device import FrameSizes, Mode
from lfpipe.config import Camera
from tests.capture.fake_camera import FakeCamera, source

FORMS = "use one of camera:N, camera:/dev/videoN, camera:NAME, file:PATH, file:PATH?loop=0|1&pace=recorded|max|HZ, or demo"
ITEMS = "a file accepts loop=0|1 and pace=recorded|max|HZ, HZ from 0.1 to 10000; if its path contains a '?', append another '?'"
KINDS = "give a video (mp4, mkv, avi, ...), a picture or a folder of pictures"
DECODABLE = (
    "use a camera with one of MJPG, JPEG, YUYV, UYVY, YVYU, RGB3, BGR3, XR24, BGR4, GREY, BA81, GBRG, GRBG, RGGB, NV12, NV21, "
    "YU12, YV12"
)
REPLUG = "unplug the camera and plug it in again"
TWINS = [CameraDevice(Path(f"/dev/video{number}"), name) for number, name in enumerate(("Front", "Cam", "CAM"))]
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


def camera(**changes: object) -> Cause:
    def cause(_: Path) -> None:
        device = FakeCamera(changes.get("mode"), changes.get("frames", ()), changes.get("offered", ("YUYV",)))  # type: ignore[arg-type]
        device.signal = bool(changes.get("signal", True))
        source(device)

    return cause


MESSAGES: dict[str, tuple[Cause, str]] = {
    "no scheme": (parsed("fiel:a.mp4"), f"'fiel:a.mp4': not a frame source\n  remedy: {FORMS}"),
    "no camera given": (parsed("camera: "), f"'camera: ': not a frame source\n  remedy: {FORMS}"),
    "no path": (parsed("file:?loop=0"), "file: no path given\n  remedy: use for example file:walk.mp4"),
    "bad pace": (parsed("file:a?pace=nan"), f"'pace=nan' in 'file:a?pace=nan': not understood\n  remedy: {ITEMS}"),
    "no file": (
        checked("a.avi", lambda path: None),
        "/here/a.avi: no such file\n  remedy: check the path; it is relative to the current directory",
    ),
    "text": (checked("a.avi", lambda path: path.write_text("text")), f"/here/a.avi: not a readable video\n  remedy: {KINDS}"),
    "damaged picture": (
        checked("a.png", lambda path: path.write_text("text")),
        "/here/a.png: not a readable picture\n  remedy: remove it from the folder, or save it again",
    ),
    "empty folder": (
        checked("a", Path.mkdir),
        "/here/a: a folder without pictures\n  remedy: it needs .bmp, .jpeg, .jpg, .pgm, .png, .ppm, .tif, .tiff, .webp files, "
        "or name a video in it",
    ),
    "unplugged": (failing(errno.ENODEV), "camera /dev/video7: unplugged\n  remedy: plug it in again"),
    "no permission": (
        failing(errno.EACCES),
        "camera /dev/video7: no permission\n  remedy: add yourself to the group `video` and log in again",
    ),
    "forbidden": (
        failing(errno.EPERM),
        "camera /dev/video7: the system forbids it\n  remedy: give a container the device: `--device /dev/video7`",
    ),
    "busy": (
        failing(errno.EBUSY),
        "camera /dev/video7: busy\n  remedy: close the program that uses it: `fuser -v /dev/video7` shows it",
    ),
    "full bus": (
        failing(errno.ENOSPC),
        "camera /dev/video7: the USB bus has no room for its frames\n  remedy: use another USB port, or --set "
        "camera.format=MJPG, or a smaller size: --set camera.width_px=640",
    ),
    "silent driver": (failing(errno.ETIMEDOUT), f"camera /dev/video7: its driver does not answer\n  remedy: {REPLUG}"),
    "other failure": (failing(errno.EIO), f"camera /dev/video7: its driver failed (Input/output error)\n  remedy: {REPLUG}"),
    "no signal": (
        camera(signal=False),
        "camera /dev/null: no signal at its input\n  remedy: connect and switch on what it is to show",
    ),
    "no picture": (camera(frames=[TimeoutError()]), f"camera /dev/null: no picture for 5 s\n  remedy: {REPLUG}"),
    "unknown formats": (
        camera(offered=["H264", "HSV3"]),
        f"camera /dev/null: none of its pixel formats can be decoded (H264, HSV3)\n  remedy: {DECODABLE}",
    ),
    "another format": (
        camera(offered=[FrameSizes("YUYV", 640, 480)], mode=Mode("H264", 640, 480, 0, 30.0)),
        f"camera /dev/null: none of its pixel formats can be decoded (H264)\n  remedy: {DECODABLE}",
    ),
    "impossible rows": (
        camera(mode=Mode("YUYV", 640, 480, 1279, 30.0)),
        "camera /dev/null: YUYV of 640 px with 1279 bytes per row\n  remedy: set another camera.format, or another size",
    ),
    "two of a name": (
        lambda _: by_name("cam", TWINS),
        "camera:cam: 2 cameras have that name\n  remedy: use camera:/dev/video1 or camera:/dev/video2",
    ),
    "no number": (
        lambda _: OpenCVCamera(Path("/dev/front"), Camera()),
        "camera /dev/front: not the number of a camera\n  remedy: use for example camera:0",
    ),
}
