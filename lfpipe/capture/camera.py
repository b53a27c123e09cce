"""A camera through V4L2: asked for explicitly, read back, stamped by the kernel where it can be."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path
from typing import Any, Protocol

# OpenCV waits 10 s for a stalled camera unless told otherwise (whole seconds, read at its first use).
os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.spec import CameraSpec
from lfpipe.capture.v4l2 import cameras, is_capture
from lfpipe.errors import UserError
from lfpipe.files.decoding import fitted, retrieved_jpeg
from lfpipe.host import opencv_log

STALL_S = 0.9  # a grab that failed after this long ran into the driver's time-out; one that failed sooner found no camera
START_GRABS = 5  # of a second each at the most: some cameras take seconds to their first frame
MAX_STAMP_AGE_NS = 2_000_000_000
BUFFERS = 2  # with 1 the driver has nowhere to put a frame while the last one is out; every one above 2 adds a frame of age


class Device(Protocol):
    """What is used of cv2.VideoCapture."""

    def set(self, propId: int, value: float) -> bool: ...
    def get(self, propId: int) -> float: ...
    def grab(self) -> bool: ...
    def retrieve(self, image: Any = ...) -> tuple[bool, Any]: ...
    def release(self) -> None: ...


def pixel_format(camera: config.Camera) -> str:
    """The four characters to ask for. Up to 640x480 uncompressed YUYV fits USB 2 at 30 Hz and saves decoding a JPEG."""
    if camera.format != "auto":
        return camera.format
    return "YUYV" if camera.width_px * camera.height_px <= 640 * 480 else "MJPG"


def fourcc_text(value: float) -> str:
    """The number that OpenCV reads back as its four characters; "?" where the driver tells none."""
    code = int(value)
    return code.to_bytes(4, "little").decode("ascii", "replace").strip() if 0 < code < 1 << 32 else "?"


def sensor_stamp_ns(position_ms: float, now_ns: int) -> int | None:
    """The kernel's stamp of a frame, where position_ms is one: on the monotonic clock and not older than MAX_STAMP_AGE_NS.

    Some drivers stamp with the wall clock or not at all; then None.
    """
    if not 0 < position_ms < 1e15:
        return None
    stamp_ns = round(position_ms * 1000) * 1000  # the driver counts in whole microseconds
    return stamp_ns if 0 <= now_ns - stamp_ns <= MAX_STAMP_AGE_NS else None


def configure(device: Device, camera: config.Camera) -> tuple[int, int, float, tuple[str, ...]]:
    """Asks device for format, size and rate: (width_px, height_px, rate_hz, notes) that it really took, read back.

    The order matters: each of the first resets the ones after it.
    """
    asked_format = pixel_format(camera)
    device.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*asked_format))
    device.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width_px)
    device.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height_px)
    device.set(cv2.CAP_PROP_FPS, camera.rate_hz)
    device.set(cv2.CAP_PROP_BUFFERSIZE, BUFFERS)
    width_px = int(device.get(cv2.CAP_PROP_FRAME_WIDTH))
    height_px = int(device.get(cv2.CAP_PROP_FRAME_HEIGHT))
    told_hz = device.get(cv2.CAP_PROP_FPS)
    rate_hz = told_hz if 0 < told_hz < 10_000 else camera.rate_hz
    got_format = fourcc_text(device.get(cv2.CAP_PROP_FOURCC))
    notes = [f"the camera gives {got_format} {width_px}x{height_px} at {rate_hz:g} Hz"]
    if got_format != asked_format:
        notes.append(f"{asked_format} was asked for, {got_format} is what the camera gives")
    if (width_px, height_px) != (camera.width_px, camera.height_px):
        notes.append(f"frames of {width_px}x{height_px} are scaled to {camera.width_px}x{camera.height_px}")
    if abs(rate_hz - camera.rate_hz) > 0.01 * camera.rate_hz:
        notes.append(f"{camera.rate_hz:g} Hz were asked for, {rate_hz:g} Hz is what the camera gives")
    return width_px, height_px, rate_hz, tuple(notes)


def _others(path: Path) -> str:
    there = ", ".join(f"camera:{camera.path} ({camera.name})" for camera in cameras() if camera.path != path)
    return f"cameras here: {there}" if there else "no camera is here: use --camera demo, or a recording with --camera file:PATH"


def check_device(path: Path) -> None:
    """Raises UserError where path cannot be a camera: not there, not permitted, or another kind of device."""
    try:
        capture = is_capture(path)
    except FileNotFoundError:
        raise UserError(f"camera {path}: no such device", _others(path)) from None
    except PermissionError:
        raise UserError(f"camera {path}: no permission", "add yourself to the group `video` and log in again") from None
    except OSError as error:
        if error.errno == errno.EBUSY:
            raise _busy(path) from None
        if error.errno == errno.ETIMEDOUT:
            raise UserError(f"camera {path}: {error.strerror}", "plug it out and in again") from None
        raise UserError(f"camera {path}: not a camera ({error.strerror})", _others(path)) from None
    if not capture:
        raise UserError(f"camera {path}: this device gives no pictures (a camera's node for metadata?)", _others(path))


def _busy(path: Path) -> UserError:
    return UserError(f"camera {path}: busy, or gives no picture", f"close the program that uses it: `fuser -v {path}` names it")


def gives_jpegs(device: Device) -> bool:
    """Whether device, configured, delivers JPEGs; it then hands them out as they are. Any later setting would undo that."""
    return fourcc_text(device.get(cv2.CAP_PROP_FOURCC)) in ("MJPG", "JPEG") and device.set(cv2.CAP_PROP_CONVERT_RGB, 0)


class CameraSource:
    """A camera. Frames are stamped by the kernel where its stamps are on the monotonic clock, else when they are taken."""

    def __init__(self, path: Path, camera: config.Camera, device: Device) -> None:
        """device: opened, not yet configured. Raises UserError where it gives no first frame."""
        self._path, self._device, self._seq = path, device, 0
        width_px, height_px, rate_hz, notes = configure(device, camera)
        self._jpeg = gives_jpegs(device)
        if not any(device.grab() for _ in range(START_GRABS)):
            device.release()
            raise _busy(path)
        if sensor_stamp_ns(device.get(cv2.CAP_PROP_POS_MSEC), time.monotonic_ns()) is None:
            notes += ("the driver gives no usable time stamps: frames are stamped when they are taken",)
        self._own_size: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
        self.info = SourceInfo(f"camera:{path}", width_px, height_px, rate_hz, live=True, jpeg=self._jpeg, notes=notes)

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`. Raises TimeoutError where the camera stalls, UserError where it is gone."""
        began_ns = time.monotonic_ns()
        while True:
            grabbed = self._device.grab()
            read_ns = time.monotonic_ns()
            if not grabbed:
                if not self._path.exists() or read_ns - began_ns < STALL_S * 1e9:
                    raise UserError(f"camera {self._path}: gone, or taken by another program", "plug it in again")
                raise TimeoutError(f"camera {self._path}: no frame for {(read_ns - began_ns) / 1e9:.1f} s")
            stamp_ns = sensor_stamp_ns(self._device.get(cv2.CAP_PROP_POS_MSEC), read_ns)
            whole, packet = self._retrieve(out)
            if whole:
                break
            if read_ns - began_ns > STALL_S * 1e9:  # a frame damaged on the cable is passed over, but not for ever
                raise TimeoutError(f"camera {self._path}: nothing but damaged frames")
        taken = Frame(self._seq, read_ns if stamp_ns is None else stamp_ns, read_ns, packet)
        self._seq += 1
        return taken

    def _retrieve(self, out: NDArray[np.uint8]) -> tuple[bool, NDArray[np.uint8] | None]:
        """Puts the frame that was grabbed into out: whether it is whole, and the JPEG that it came as."""
        if self._jpeg:
            found = retrieved_jpeg(self._device)
            if found is None:
                return False, None
            packet, picture = found
            fitted(picture, out)
            return True, packet if picture.shape == self._own_size.shape else None
        try:
            whole, frame = self._device.retrieve(out if out.shape == self._own_size.shape else self._own_size)
        except cv2.error:  # half a frame
            return False, None
        if whole:
            fitted(np.asarray(frame, np.uint8), out)
        return whole, None

    def close(self) -> None:
        self._device.release()


def open_camera(spec: CameraSpec, camera: config.Camera) -> CameraSource:
    """Opens and configures the device. Raises UserError where it is missing, not permitted, no camera, or busy."""
    check_device(spec.path)
    with opencv_log.silent():
        device = cv2.VideoCapture(str(spec.path), cv2.CAP_V4L2)
        if not device.isOpened():
            raise _busy(spec.path)
        return CameraSource(spec.path, camera, device)
