"""Cameras that the kernel lists, and the current device of one of them: device numbers change, name and bus do not."""

import errno
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from lfpipe.capture.camera_device import CameraDevice as CameraDevice
from lfpipe.capture.time_limit import with_time_limit
from lfpipe.capture.v4l2_device import V4L2Device
from lfpipe.host import handover
from lfpipe.host.paths import exists

SYS, DEV = Path("/sys/class/video4linux"), Path("/dev")
ANSWER_S = 3.0  # drivers answer in microseconds; a stuck one never does
BUSY_S = 60.0  # thousands of calls on an emulated machine

T = TypeVar("T")


def _limited(call: Callable[[], T]) -> T:
    try:
        return with_time_limit(ANSWER_S, call, BUSY_S)
    except TimeoutError as error:
        if error.errno is not None:  # the driver's own
            raise
        raise OSError(errno.ETIMEDOUT, "its driver does not answer") from None


def opened(path: Path) -> V4L2Device:
    """The device; reuses the descriptor if this process keeps it open: see `V4L2Device.keep`.

    Raises OSError as the driver does, ETIMEDOUT after ANSWER_S.
    """
    kept = handover.take(str(path))
    return _limited(lambda: V4L2Device(path, kept))


def asking(path: Path, question: Callable[[V4L2Device], T]) -> T:
    """Opens the device, queries it and closes it. Raises OSError from the driver, ETIMEDOUT after ANSWER_S."""

    def ask() -> T:
        device = V4L2Device(path)
        try:
            return question(device)
        finally:
            device.close()

    return _limited(ask)


def nodes(sys: Path = SYS, dev: Path = DEV) -> list[CameraDevice]:
    """Every video device by number, cameras or not. Opens none of them."""
    found = []
    for entry in sorted(sys.glob("video*"), key=lambda entry: int("0" + entry.name.removeprefix("video"))):
        found.append(describe(dev / entry.name, sys))
    return found


def describe(path: Path, sys: Path = SYS) -> CameraDevice:
    """The device at path with its name and bus."""
    entry = sys / path.resolve().name
    try:
        name = (entry / "name").read_text().strip()
    except OSError:
        name = ""
    device = entry / "device"
    return CameraDevice(path, name, str(device.resolve()) if exists(device) else "")


def cameras(sys: Path = SYS, dev: Path = DEV) -> list[CameraDevice]:
    """The capturing devices, by number. Includes devices that cannot be queried (busy, no permission)."""
    found = []
    for device in nodes(sys, dev):
        try:
            if not asking(device.path, lambda device: device.captures):
                continue
        except PermissionError:
            pass
        except OSError:
            if not exists(device.path):
                continue
        found.append(device)
    return found


def named(name: str, found: list[CameraDevice]) -> list[CameraDevice]:
    """The devices with this name, ignoring case; if there are none, those whose name contains it."""
    wanted = name.casefold()
    return [d for d in found if d.name.casefold() == wanted] or [d for d in found if wanted in d.name.casefold()]


def find_again(known: CameraDevice, sys: Path = SYS, dev: Path = DEV) -> Path:
    """The current path of a camera: the same name on the same bus, else the same name, else its old path.

    Nodes of one camera (pictures, metadata) share name and bus: the one at the old path wins, else the first that captures.
    """
    same = [device for device in nodes(sys, dev) if device.name and device.name == known.name]
    candidates = [device for device in same if device.bus == known.bus] or same
    if not candidates or any(device.path == known.path for device in candidates):
        return known.path
    for device in candidates:
        try:
            if asking(device.path, lambda device: device.captures):
                return device.path
        except OSError:
            continue
    return candidates[0].path
