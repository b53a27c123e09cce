"""What Linux tells about its cameras without starting one: names from /sys, formats from the driver.

Numbers and layouts are those of linux/videodev2.h, which is a stable binary interface.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import attrs

from lfpipe.capture.time_limit import with_time_limit

SYS = Path("/sys/class/video4linux")

QUERYCAP, QUERYCAP_BYTES = 0x80685600, 104
ENUM_FMT, ENUM_FMT_BYTES = 0xC0405602, 64
ENUM_FRAMESIZES, ENUM_FRAMESIZES_BYTES = 0xC02C564A, 44
ENUM_FRAMEINTERVALS, ENUM_FRAMEINTERVALS_BYTES = 0xC034564B, 52
CAP_VIDEO_CAPTURE, CAP_DEVICE_CAPS = 0x1, 0x80000000
BUF_TYPE_VIDEO_CAPTURE, FRAME_SIZE_DISCRETE = 1, 1
INTERVAL_DISCRETE = 1
ANSWER_S = 3.0  # drivers answer such questions in microseconds; one that is stuck never does

T = TypeVar("T")


@attrs.frozen
class CameraDevice:
    """A device that the kernel lists. name: as the driver gives it; empty where unknown."""

    path: Path
    name: str


def captures(querycap: bytes) -> bool:
    """Whether a v4l2_capability says that this very node delivers pictures (a camera's second node is for metadata)."""
    whole, node = struct.unpack_from("=II", querycap, 84)
    return bool((node if whole & CAP_DEVICE_CAPS else whole) & CAP_VIDEO_CAPTURE)


def is_capture(path: Path) -> bool:
    """Asks the driver at path. Raises OSError where it cannot be opened, is no video device, or does not answer in ANSWER_S."""
    return _answered(lambda: _is_capture(path))


def _answered(call: Callable[[], T]) -> T:
    try:
        return with_time_limit(ANSWER_S, call)
    except TimeoutError:
        raise OSError(errno.ETIMEDOUT, "its driver does not answer") from None


def _is_capture(path: Path) -> bool:
    descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    try:
        reply = bytearray(QUERYCAP_BYTES)
        fcntl.ioctl(descriptor, QUERYCAP, reply)
        return captures(bytes(reply))
    finally:
        os.close(descriptor)


def cameras(sys: Path = SYS, dev: Path = Path("/dev")) -> list[CameraDevice]:
    """The capturing devices that the kernel lists, by number. One that cannot be asked (busy, no permission) is listed too."""
    found = []
    for entry in sorted(sys.glob("video*"), key=lambda entry: int("0" + entry.name.removeprefix("video"))):
        path = dev / entry.name
        try:
            if not is_capture(path):
                continue
        except PermissionError:
            pass
        except OSError:
            if not path.exists():
                continue
        try:
            name = (entry / "name").read_text().strip()
        except OSError:
            name = ""
        found.append(CameraDevice(path, name))
    return found


def _asked(descriptor: int, request: int, message: bytearray) -> bytes | None:
    try:
        fcntl.ioctl(descriptor, request, message)
    except OSError:  # EINVAL: the list is at its end
        return None
    return bytes(message)


def formats(path: Path, rates: bool = False) -> list[str]:
    """Pixel formats and frame sizes of the camera at path, one text a format: "MJPG 640x480 1280x720".

    rates: with the rates of each size in Hz: "MJPG 640x480@30,15 1280x720@30".

    Raises OSError where the device cannot be opened, or does not answer in ANSWER_S.
    """
    return _answered(lambda: _formats(path, rates))


def _formats(path: Path, rates: bool) -> list[str]:
    descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    try:
        lines = []
        for index in range(64):
            message = bytearray(ENUM_FMT_BYTES)
            struct.pack_into("=II", message, 0, index, BUF_TYPE_VIDEO_CAPTURE)
            if (reply := _asked(descriptor, ENUM_FMT, message)) is None:
                break
            pixel = reply[44:48]
            lines.append(" ".join([pixel.decode("ascii", "replace").strip(), *_sizes(descriptor, pixel, rates)]))
        return lines
    finally:
        os.close(descriptor)


def rate_of(frmivalenum: bytes) -> str:
    """The rate in Hz that a v4l2_frmivalenum tells: of a discrete interval, or the fastest of a range."""
    numerator, denominator = struct.unpack_from("=II", frmivalenum, 20)  # a range begins with its shortest interval
    return f"{denominator / numerator:.4g}" if numerator else "?"


def _rates(descriptor: int, pixel: bytes, width: int, height: int) -> str:
    found: list[str] = []
    for index in range(64):
        message = bytearray(ENUM_FRAMEINTERVALS_BYTES)
        struct.pack_into("=I4sII", message, 0, index, pixel, width, height)
        if (reply := _asked(descriptor, ENUM_FRAMEINTERVALS, message)) is None:
            break
        found.append(rate_of(reply))
        if struct.unpack_from("=I", reply, 16)[0] != INTERVAL_DISCRETE:
            break
    return "@" + ",".join(found) if found else ""


def _sizes(descriptor: int, pixel: bytes, rates: bool) -> list[str]:
    sizes = []
    for index in range(256):
        message = bytearray(ENUM_FRAMESIZES_BYTES)
        struct.pack_into("=I4s", message, 0, index, pixel)
        if (reply := _asked(descriptor, ENUM_FRAMESIZES, message)) is None:
            break
        (kind,) = struct.unpack_from("=I", reply, 8)
        if kind != FRAME_SIZE_DISCRETE:
            min_w, max_w, _, min_h, max_h, _ = struct.unpack_from("=6I", reply, 12)
            return [f"{min_w}x{min_h}..{max_w}x{max_h}"]
        width, height = struct.unpack_from("=II", reply, 12)
        sizes.append(f"{width}x{height}" + (_rates(descriptor, pixel, width, height) if rates else ""))
    return sizes
