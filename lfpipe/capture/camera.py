"""A V4L2 camera as a source: requests a mode, reports the actual one, decodes frames and stamps
them with their exposure.
"""

import contextlib
import errno
import logging
import os
import time
from collections.abc import Iterator
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.camera_list import LIBCAMERA, START_S, CameraControls, opened, others
from lfpipe.capture.frame_source import Frame, SourceInfo, size_notes, stall_s
from lfpipe.capture.v4l2_device import (
    CHEAPEST,
    DECODED,
    JPEGS,
    SMALL_PX,
    FrameDecoder,
    FrameSizes,
    Mode,
    RawFrame,
    V4L2Device,
    choose,
)
from lfpipe.errors import UserError
from lfpipe.eyes import MAX_STEP_NS
from lfpipe.transport.ring import StampKind

log = logging.getLogger(__name__)

CONTROLS_S = 1.0  # longest wait for the camera's controls; they are set later if it is slower
REPLUG = "unplug the camera and plug it in again"
# An older stamp comes from another clock. Until the next frame at 6 Hz, its eyes are not stale.
MAX_AGE_NS = MAX_STEP_NS * 3 // 5
HARDWARE_STAMPS = Path("/sys/module/uvcvideo/parameters/hwtimestamps")
USB = (
    "use another USB port, or --set camera.format=MJPG, or a smaller size: --set"
    " camera.width_px=640"
)
TROUBLE = {  # errno of a driver's call -> what it means, what helps; {} is the device
    errno.ENODEV: ("unplugged", "plug it in again"),
    errno.ENXIO: ("unplugged", "plug it in again"),
    errno.EACCES: ("no permission", "add yourself to the group `video` and log in again"),
    errno.EPERM: ("the system forbids it", "give a container the device: `--device {}`"),
    errno.EBUSY: ("busy", "close the program that uses it: `fuser -v {}` shows it"),
    errno.ENOSPC: ("the USB bus lacks bandwidth for its frames", USB),
    errno.ETIMEDOUT: ("its driver does not answer", REPLUG),
}


def stamp_kind(driver: str, start_of_exposure: bool, hardware: Path = HARDWARE_STAMPS) -> StampKind:
    """The event that the driver's stamps mark. start_of_exposure: the flag of its buffers.

    uvcvideo sets that flag always, but stamps the arrival of the first packet
    (uvc_video_decode_start) unless its parameter hwtimestamps is set.
    """
    if not start_of_exposure:
        return StampKind.END_OF_FRAME
    by_camera = driver != "uvcvideo"
    with contextlib.suppress(OSError):
        by_camera |= hardware.read_text().strip() not in ("0", "N")
    return StampKind.START_OF_EXPOSURE if by_camera else StampKind.START_OF_TRANSFER


class SensorClock:
    """Moves stamps to the middle of the exposure.

    A stamp marks one end of the exposure, so half of the exposure time is added or subtracted. If
    the camera does not report it, half a frame period is assumed, which is off by at most a quarter
    of a period. The sensor's readout time is unknown and not corrected.

    Drivers may stamp ahead of the clock (vivid: the end of a future frame). Stamps ahead by up to
    one period are used, all shifted back by the largest lead so far: they stay evenly spaced, and
    no frame is read before its exposure.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = int(1e9 / rate_hz)
        self._lead_ns = 0

    def usable(self, stamp_ns: int, read_ns: int) -> bool:
        """Whether the stamp of a frame read at read_ns is from the monotonic clock."""
        return stamp_ns > 0 and -self._period_ns <= read_ns - stamp_ns <= MAX_AGE_NS

    def middle_ns(
        self, stamp_ns: int, kind: StampKind, read_ns: int, exposure_ns: int | None
    ) -> tuple[int, StampKind]:
        """The middle of the exposure of a frame read at read_ns, never later than read_ns, and the
        source of the value.
        """
        if not self.usable(stamp_ns, read_ns):
            return read_ns, StampKind.READ
        self._lead_ns = max(self._lead_ns, stamp_ns - read_ns)
        half_ns = (
            self._period_ns // 2 if exposure_ns is None else min(exposure_ns, self._period_ns)
        ) // 2
        sign = 1 if kind == StampKind.START_OF_EXPOSURE else -1
        return min(stamp_ns - self._lead_ns + sign * half_ns, read_ns), kind


def trouble(path: Path, error: OSError) -> UserError:
    """The device's error as a UserError."""
    code, why = error.errno, error.strerror
    if code == errno.ENOENT:
        return UserError(f"camera {path}: no such device", others(path))
    if code == errno.ENOTTY or (code == errno.EINVAL and not path.is_char_device()):
        return UserError(f"camera {path}: not a camera ({why})", others(path))
    what, remedy = TROUBLE.get(code or 0, (f"its driver failed ({why})", REPLUG))
    return UserError(f"camera {path}: {what}", remedy.format(path))


def negotiate(path: Path, device: V4L2Device, camera: config.Camera) -> tuple[Mode, SourceInfo]:
    """The mode that the device accepted, and the source that it makes: with a rate that is never 0,
    and notes on differences from the configuration.

    Raises OSError from the driver, UserError if none of the device's formats can be decoded.
    """
    wanted_px = (camera.width_px, camera.height_px)
    offered = device.fourccs()
    # of a driver that lists nothing
    usual = JPEGS if camera.width_px * camera.height_px > SMALL_PX else CHEAPEST
    formats = [fourcc for fourcc in offered or [usual[0], camera.format] if fourcc in DECODED]
    formats = [camera.format] if camera.format in formats else formats
    modes = [
        mode
        for fourcc in formats
        for mode in device.sizes(fourcc)
        or [FrameSizes(fourcc=fourcc, width_px=camera.width_px, height_px=camera.height_px)]
    ]
    wanted_hz = camera.nominal_hz
    requested = choose(modes, *wanted_px, wanted_hz)
    if requested and requested.rates_hz and requested.rates_hz[0] > 0.98 * camera.highest_hz:
        wanted_hz = camera.highest_hz  # in the same format, whose frames cost no more
    mode = None
    if requested is not None:
        size_px = requested.width_px, requested.height_px
        mode = device.configure(requested.fourcc, *size_px, wanted_hz)
        offered = [mode.fourcc]
    if mode is None or mode.fourcc not in DECODED:
        raise UserError(
            f"camera {path}: none of its pixel formats can be decoded ({', '.join(offered)})",
            f"use a camera with one of {', '.join(DECODED)}",
        )
    size_px = (mode.width_px, mode.height_px)
    rate_hz = mode.rate_hz or camera.nominal_hz
    log.info("camera %s: requested %s, delivers %s", path, requested, mode)
    notes = [
        f"the camera delivers {mode.fourcc} {mode.width_px}x{mode.height_px} at {rate_hz:.4g} Hz"
    ]
    if camera.format not in ("auto", mode.fourcc):
        notes.append(f"{camera.format} requested, {mode.fourcc} delivered")
    notes += size_notes(size_px, camera)
    if camera.rate_hz != "auto" and abs(rate_hz - wanted_hz) > 0.01 * wanted_hz:
        notes.append(f"{wanted_hz:g} Hz requested, {rate_hz:.4g} Hz delivered")
    name = f"camera:{path}"
    jpeg = mode.fourcc in JPEGS
    return mode, SourceInfo(name, size_px, rate_hz, live=True, jpeg=jpeg, notes=tuple(notes))


def lighter(camera: config.Camera) -> Iterator[config.Camera]:
    """The same camera with ever less data: compressed, at half the rate, at half the size."""
    if camera.format == "auto":
        camera = attrs.evolve(camera, format="MJPG")
        yield camera
    yield attrs.evolve(camera, rate_hz=camera.nominal_hz / 2)
    yield attrs.evolve(camera, width_px=camera.width_px // 2, height_px=camera.height_px // 2)


def start(path: Path, device: V4L2Device, camera: config.Camera) -> tuple[Mode, SourceInfo]:
    """Starts the stream; returns as `negotiate`. Where the USB bus lacks bandwidth, as for a second
    camera on it, in a mode that needs less. Raises as `negotiate`.
    """
    tried: list[Mode] = []
    for request in (camera, *lighter(camera)):
        mode, info = negotiate(path, device, request)
        if mode in tried:
            continue
        tried.append(mode)
        try:
            device.start()
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            log.info("camera %s: no bandwidth for %s", path, mode)
            continue
        less = () if request is camera else ("its USB bus lacks bandwidth for more",)
        return mode, attrs.evolve(info, notes=(*info.notes, *less))
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class CameraSource:
    """A streaming camera.

    source_seq follows the driver's count: frames that the driver lost leave gaps.
    """

    def __init__(self, path: Path, camera: config.Camera, device: V4L2Device) -> None:
        """device: open; closed by this object. Raises UserError if it cannot be configured or
        delivers no first frame.
        """
        self._path = path
        self._device = device
        with contextlib.ExitStack() as undo:
            undo.callback(device.close)
            try:
                if not device.signal:
                    raise self._no_signal()
                mode, info = start(path, device, camera)
                self._decoder = FrameDecoder(mode)
                undo.callback(self._decoder.close)
                self._controls = CameraControls(device.duplicate(), camera)
                undo.callback(self._controls.end, CONTROLS_S)
                # discarded: often dark, and old when the session is ready
                first = device.read(START_S)
            except TimeoutError:
                raise UserError(f"camera {path}: no picture for {START_S:g} s", REPLUG) from None
            except OSError as error:
                raise trouble(path, error) from None
            except ValueError as error:
                raise UserError(
                    f"camera {path}: {error}", "set another camera.format, or another size"
                ) from None
            # restores the controls, then ends the stream
            self.close = undo.pop_all().close
        self._clock = SensorClock(info.rate_hz)
        self._period_ns = 1e9 / info.rate_hz
        self._stall_s = stall_s(info.rate_hz)
        self._kind = stamp_kind(device.driver, first.start_of_exposure)
        self._seq = -1
        self._sequence = first.sequence
        self._stamp_ns = first.stamp_ns
        notes = list(info.notes)
        now_ns = time.monotonic_ns()
        if not self._clock.usable(first.stamp_ns, now_ns):
            notes.append("the driver gives no usable time stamps: using the time of reading")
            self._stamp_ns = now_ns
        if not self._controls.applied.wait(CONTROLS_S):
            notes.append(
                f"its controls have not answered for {CONTROLS_S:g} s: exposure and others may be"
                " set later, or never"
            )
        self.info = attrs.evolve(info, notes=(*notes, *self._controls.notes.values()))

    def _no_signal(self) -> UserError:
        return UserError(
            f"camera {self._path}: no signal at its input",
            "connect its source and switch it on",
        )

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`.

        Raises TimeoutError if the camera stalls, UserError if it is gone, fails or has no signal.
        """
        if not self._controls.signal:
            raise self._no_signal()
        until_ns = time.monotonic_ns() + int(self._stall_s * 1e9)
        damaged = 0
        while (left_s := (until_ns - time.monotonic_ns()) / 1e9) > 0:
            try:
                raw = self._device.read(left_s)
            except TimeoutError:
                break
            except OSError as error:
                raise trouble(self._path, error) from None
            read_ns = time.monotonic_ns()
            self._count(raw, read_ns)
            whole, packet = (False, None) if raw.damaged else self._decoder.decode(raw.data, out)
            if whole:
                sensor_ns, kind = self._clock.middle_ns(
                    raw.stamp_ns, self._kind, read_ns, self._controls.exposure_ns
                )
                return Frame(self._seq, sensor_ns, read_ns, packet, kind)
            damaged += 1
            log.debug(
                "camera %s: damaged frame %d of %d bytes", self._path, raw.sequence, raw.data.size
            )
        raise TimeoutError(
            f"camera {self._path}: no whole frame for {self._stall_s:.2g} s, {damaged} damaged"
        )

    def _count(self, raw: RawFrame, read_ns: int) -> None:
        """Advances the frame number by the driver's count, but never by more frames than the time
        allows.

        Some drivers count fields, or not at all.
        """
        stamp_ns = raw.stamp_ns if self._clock.usable(raw.stamp_ns, read_ns) else read_ns
        by_driver = (raw.sequence - self._sequence) % (1 << 32)
        by_time = round((stamp_ns - self._stamp_ns) / self._period_ns)
        self._sequence = raw.sequence
        self._stamp_ns = stamp_ns
        self._seq += max(1, min(by_driver, by_time)) if self._seq >= 0 else 1


def open_device(path: Path) -> V4L2Device:
    """Raises UserError if path cannot be a camera: missing, not permitted, or another kind of
    device.
    """
    try:
        device = opened(path)
    except OSError as error:
        raise trouble(path, error) from None
    if device.captures:
        return device
    device.close()
    if device.multi_planar:
        raise UserError(
            f"camera {path}: is multi-planar, which lfpipe cannot read itself", LIBCAMERA
        )
    raise UserError(
        f"camera {path}: this device delivers no pictures (a camera's node for metadata?)",
        others(path),
    )


def open_camera(path: Path, camera: config.Camera) -> CameraSource:
    """Opens, configures and starts the device.

    Raises UserError if it is missing, not permitted, no camera, or busy.
    """
    return CameraSource(path, camera, open_device(path))


def check_camera(path: Path, camera: config.Camera) -> SourceInfo:
    """The format that the camera will deliver.

    Configures it without starting it. Raises UserError as `open_camera` does.
    """
    with contextlib.closing(open_device(path)) as device:
        try:
            _, info = negotiate(path, device, camera)
        except OSError as error:
            raise trouble(path, error) from None
    return info
