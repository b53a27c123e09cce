"""A V4L2 camera as a source: requests a mode, reports the actual one, decodes frames and stamps them with their exposure."""

import errno
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.camera_controls import CameraControls, Controls, exposure_ns
from lfpipe.capture.camera_list import CameraDevice, cameras, describe, find_again, named, nodes, opened
from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.pixel_formats import DECODED, FrameDecoder, choose
from lfpipe.capture.sensor_clock import SensorClock, stamp_kind
from lfpipe.capture.spec import CameraSpec
from lfpipe.capture.v4l2_device import Mode, V4L2Device
from lfpipe.capture.v4l2_stream import RawFrame, SourceChangedError, V4L2Stream
from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_note
from lfpipe.host.paths import exists

STALL_S = 0.9  # longest wait for a frame
START_S = 5.0  # longest wait for the first frame: some cameras need seconds
EXPOSURE_CHECK_S = 2.0  # automatic exposure follows the light
REPLUG = "unplug the camera and plug it in again"
GONE = (errno.ENODEV, errno.ENXIO, errno.ENOENT)


class Device(Controls, Protocol):
    """The part of `V4L2Device` in use here."""

    @property
    def driver(self) -> str: ...
    def fourccs(self) -> list[str]: ...
    def configure(self, fourcc: str, width_px: int, height_px: int, rate_hz: float) -> Mode: ...
    def close(self) -> None: ...


class Stream(Protocol):
    """The part of `V4L2Stream` in use here."""

    def read(self, timeout_s: float) -> RawFrame: ...
    def close(self) -> None: ...


def _others(path: Path) -> str:
    there = ", ".join(f"camera:{camera.path} ({camera.name})" for camera in cameras() if camera.path != path)
    return f"available cameras: {there}" if there else "no camera found: use --camera demo, or --camera file:PATH"


def trouble(path: Path, error: OSError) -> UserError:
    """The device's error in the user's words."""
    code, what = error.errno, f"camera {path}"
    if isinstance(error, SourceChangedError):
        return UserError(f"{what}: its picture size or signal changed", "it is reopened")
    if code == errno.ENOENT:
        return UserError(f"{what}: no such device", _others(path))
    if code in GONE:
        return UserError(f"{what}: unplugged", "plug it in again")
    if code == errno.EACCES:
        return UserError(f"{what}: no permission", "add yourself to the group `video` and log in again")
    if code == errno.EBUSY:
        return UserError(f"{what}: busy", f"close the program that uses it: `fuser -v {path}` shows it")
    if code in (errno.ENOTTY, errno.EINVAL) and not path.is_char_device():
        return UserError(f"{what}: not a camera ({error.strerror})", _others(path))
    if code == errno.ENOTTY:
        return UserError(f"{what}: not a camera", _others(path))
    if code == errno.ETIMEDOUT:
        return UserError(f"{what}: {error.strerror}", REPLUG)
    return UserError(f"{what}: its driver failed ({error.strerror})", REPLUG)


def negotiate(path: Path, device: Device, camera: config.Camera) -> tuple[Mode, tuple[str, ...]]:
    """The mode that the device accepted, with a rate that is never 0, and notes on differences from the configuration.

    Raises OSError from the driver, UserError if none of the device's formats can be decoded.
    """
    offered = device.fourccs()
    wanted = camera.format if camera.format != "auto" else choose(offered, camera.width_px, camera.height_px)
    listed = ", ".join(offered)
    if not wanted:
        remedy = f"use a camera with one of {', '.join(DECODED)}"
        raise UserError(f"camera {path}: none of its pixel formats can be decoded ({listed})", remedy)
    mode = device.configure(wanted, camera.width_px, camera.height_px, camera.rate_hz)
    if mode.fourcc not in DECODED and (other := choose(offered, camera.width_px, camera.height_px)):
        mode = device.configure(other, camera.width_px, camera.height_px, camera.rate_hz)
    if mode.fourcc not in DECODED:
        raise UserError(f"camera {path}: delivers {mode.fourcc}, which cannot be decoded", "use another camera")
    rate_hz = mode.rate_hz or camera.rate_hz
    size = f"{mode.width_px}x{mode.height_px}"
    notes = [f"the camera delivers {mode.fourcc} {size} at {rate_hz:.4g} Hz"]
    if mode.fourcc != wanted:
        notes.append(f"{wanted} requested, {mode.fourcc} delivered")
    if (mode.width_px, mode.height_px) != (camera.width_px, camera.height_px):
        notes.append(fit_note((mode.width_px, mode.height_px), (camera.width_px, camera.height_px)))
    if abs(rate_hz - camera.rate_hz) > 0.01 * camera.rate_hz:
        notes.append(f"{camera.rate_hz:g} Hz requested, {rate_hz:.4g} Hz delivered")
    return Mode(mode.fourcc, mode.width_px, mode.height_px, mode.stride, rate_hz), tuple(notes)


class CameraSource:
    """A streaming camera. source_seq follows the driver's count: frames that the driver lost leave gaps."""

    def __init__(self, path: Path, camera: config.Camera, device: Device, start: Callable[[Any], Stream] = V4L2Stream) -> None:
        """device: open; closed by this object. Raises UserError if it cannot be configured or delivers no first frame."""
        self._path, self._device = path, device
        self._stream: Stream | None = None
        self._controls: CameraControls | None = None
        try:
            mode, notes = negotiate(path, device, camera)
            self._decoder = FrameDecoder(mode)
            self._controls = CameraControls(device, camera)
            self._stream = start(device)
            first = self._stream.read(START_S)  # discarded: often dark, and old when the session is ready
        except (OSError, ValueError, UserError) as error:
            self.close()
            if isinstance(error, TimeoutError):
                raise UserError(f"camera {path}: no picture for {START_S:g} s", REPLUG) from None
            if isinstance(error, OSError):
                raise trouble(path, error) from None
            if isinstance(error, ValueError):
                raise UserError(f"camera {path}: {error}", "set another camera.format, or another size") from None
            raise
        self._clock, self._period_ns = SensorClock(mode.rate_hz), 1e9 / mode.rate_hz
        self._kind = stamp_kind(device.driver, first.start_of_exposure)
        self._exposure_ns, self._exposure_due_ns = exposure_ns(device), 0
        self._seq, self._sequence, self._stamp_ns = -1, first.sequence, first.stamp_ns
        now_ns = time.monotonic_ns()
        if not self._clock.usable(first.stamp_ns, now_ns):
            notes += ("the driver gives no usable time stamps: using the time of reading",)
            self._stamp_ns = now_ns
        notes += tuple(self._controls.notes)
        jpeg = self._decoder.jpeg
        self.info = SourceInfo(f"camera:{path}", mode.width_px, mode.height_px, mode.rate_hz, live=True, jpeg=jpeg, notes=notes)

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`. Raises TimeoutError if the camera stalls, UserError if it is gone or its driver fails."""
        assert self._stream is not None
        began_ns = time.monotonic_ns()
        if self._exposure_ns is not None and began_ns > self._exposure_due_ns:  # the camera's thread is idle here
            self._exposure_ns, self._exposure_due_ns = exposure_ns(self._device), began_ns + int(EXPOSURE_CHECK_S * 1e9)
        while True:
            waited_s = (time.monotonic_ns() - began_ns) / 1e9
            if waited_s > STALL_S:
                raise TimeoutError(f"camera {self._path}: only damaged frames")
            try:
                raw = self._stream.read(STALL_S - waited_s)
            except TimeoutError:
                raise TimeoutError(f"camera {self._path}: no frame for {STALL_S:g} s") from None
            except OSError as error:
                raise trouble(self._path, error) from None
            read_ns = time.monotonic_ns()
            self._count(raw, read_ns)
            if raw.damaged:
                continue
            whole, packet = self._decoder.decode(raw.data, out)
            if whole:
                break
        sensor_ns, kind = self._clock.middle_ns(raw.stamp_ns, self._kind, read_ns, self._exposure_ns)
        return Frame(self._seq, sensor_ns, read_ns, packet, kind)

    def _count(self, raw: RawFrame, read_ns: int) -> None:
        """Advances the frame number by the driver's count, but never by more frames than the time allows.

        Some drivers count fields, or not at all.
        """
        stamp_ns = raw.stamp_ns if self._clock.usable(raw.stamp_ns, read_ns) else read_ns
        by_driver = (raw.sequence - self._sequence) % (1 << 32)
        by_time = round((stamp_ns - self._stamp_ns) / self._period_ns)
        self._sequence, self._stamp_ns = raw.sequence, stamp_ns
        self._seq += max(1, min(by_driver, by_time)) if self._seq >= 0 else 1

    def close(self) -> None:
        """Ends the stream, restores the controls and closes the device."""
        if self._stream is not None:
            self._stream.close()
        if self._controls is not None:
            self._controls.restore()
        self._device.close()


class CameraFinder:
    """Follows one camera through changes of its device number."""

    def __init__(self, spec: CameraSpec) -> None:
        self._spec = spec
        self._known: CameraDevice | None = None

    def path(self) -> Path:
        """The camera's current device file. Raises UserError if no camera, or more than one, has the name."""
        if self._known is None:
            self._known = self._by_name(self._spec.name) if self._spec.name else describe(self._spec.path)
        if not self._known.name:  # nothing to recognise it by yet
            self._known = None
            return self._spec.path
        return find_again(self._known)

    @staticmethod
    def _by_name(name: str) -> CameraDevice:
        found = named(name, nodes())
        if len(found) > 1:
            capturing = {camera.path for camera in cameras()}
            found = [device for device in found if device.path in capturing]
        if len(found) > 1:
            paths = " or ".join(f"camera:{device.path}" for device in found)
            raise UserError(f"camera:{name}: {len(found)} cameras have that name", f"use {paths}")
        if not found:
            raise UserError(f"camera:{name}: no camera of that name", _others(Path()))
        return found[0]


def open_device(path: Path) -> V4L2Device:
    """Raises UserError if path cannot be a camera: missing, not permitted, or another kind of device."""
    try:
        device = opened(path)
    except OSError as error:
        raise trouble(path, error) from None
    if not device.captures:
        device.close()
        raise UserError(f"camera {path}: this device delivers no pictures (a camera's node for metadata?)", _others(path))
    return device


def first_camera() -> Path | None:
    """The first device that captures, kept open as by `check_camera`; else the first that cannot be queried (no permission)."""
    silent = None
    for node in nodes():
        try:
            device = opened(node.path)
        except OSError:
            silent = silent or (node.path if exists(node.path) else None)
            continue
        if device.captures:
            device.keep()
            return node.path
        device.close()
    return silent


def open_camera(path: Path, camera: config.Camera) -> CameraSource:
    """Opens, configures and starts the device. Raises UserError if it is missing, not permitted, no camera, or busy."""
    return CameraSource(path, camera, open_device(path))


def check_camera(path: Path, camera: config.Camera) -> SourceInfo:
    """The format that the camera will deliver. Configures it without starting it, and keeps it open for the session that follows:
    opening and starting a webcam take up to a second each. Raises UserError as `open_camera` does.
    """
    device = open_device(path)
    try:
        mode, notes = negotiate(path, device, camera)
        jpeg = FrameDecoder(mode).jpeg
        device.keep()
    except OSError as error:
        raise trouble(path, error) from None
    finally:
        device.close()
    return SourceInfo(f"camera:{path}", mode.width_px, mode.height_px, mode.rate_hz, live=True, jpeg=jpeg, notes=notes)
