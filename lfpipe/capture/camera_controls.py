"""Exposure, gain, mains frequency and dynamic frame rate of a camera: applied at the start, restored at the end.

A camera may take a second to answer, or never answer. So a thread of its own asks it while frames are read.
"""

import logging
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from lfpipe import config
from lfpipe.capture.v4l2_device import V4L2Device
from lfpipe.files.safe_files import reason

log = logging.getLogger(__name__)

# linux/v4l2-controls.h
AUTO_GAIN, GAIN, POWER_LINE = 0x00980912, 0x00980913, 0x00980918
AUTO_EXPOSURE, EXPOSURE, DYNAMIC_FRAMERATE = 0x009A0901, 0x009A0902, 0x009A0903
MANUAL_EXPOSURE = 1
EXPOSURE_UNITS_MS, EXPOSURE_UNIT_NS = 10, 100_000  # EXPOSURE counts 0.1 ms
POWER_LINE_HZ = (0, 50, 60)  # by menu entry; the next is automatic
CHECK_S = 2.0  # automatic exposure follows the light
RESTORE_TRIES = 3  # a busy camera misses a request; nobody would set the control again


def control_texts(device: V4L2Device) -> list[str]:
    """The controls that the device has, with their present values and ranges, for people. Raises OSError as the driver does."""
    texts = []
    exposure = "camera.exposure", EXPOSURE, EXPOSURE_UNITS_MS, " ms", AUTO_EXPOSURE, MANUAL_EXPOSURE
    for key, control, scale, unit, switch, manual in (exposure, ("camera.gain", GAIN, 1, "", AUTO_GAIN, 0)):
        if (span := device.control_range(control)) is not None:
            automatic = device.control_range(switch) is not None and device.control(switch) != manual
            value, low, high = (units / scale for units in (device.control(control), span.minimum, span.maximum))
            texts.append(f"{key} {value:g}{unit}{' (automatic)' if automatic else ''} [{low:g} to {high:g}{unit}]")
    if (span := device.control_range(POWER_LINE)) is not None:
        entry = device.control(POWER_LINE)
        hz = f"{POWER_LINE_HZ[entry]} Hz" if entry < len(POWER_LINE_HZ) else "automatic"
        texts.append(f"camera.power_line_hz {hz} [0 to {POWER_LINE_HZ[min(span.maximum, 2)]} Hz]")
    if device.control_range(DYNAMIC_FRAMERATE) is not None:
        texts.append(f"camera.dynamic_framerate {device.control(DYNAMIC_FRAMERATE)} [0 to 1]")
    return texts


class CameraControls(threading.Thread):
    """Applies the configuration to a device, then asks it every CHECK_S; at the end restores the old settings and closes it.

    notes: for the user, complete once `applied` is set. exposure_ns: as the camera reports it, None if it does not. signal: False
    if nothing is connected to the device's input.
    """

    def __init__(self, device: V4L2Device, camera: config.Camera) -> None:
        """device: open; it belongs to the thread from now on."""
        super().__init__(name="camera-controls", daemon=True)
        self._device, self._camera = device, camera
        self._before: list[tuple[int, int]] = []
        self._ending = threading.Event()
        self.applied = threading.Event()
        self.notes: list[str] = []
        self.exposure_ns: int | None = None
        self.signal = True
        self.start()

    def run(self) -> None:
        try:
            self._apply()
            while True:
                self.exposure_ns, self.signal = self._asked(self._exposure_ns), self._device.signal
                self.applied.set()
                if self._ending.wait(CHECK_S):
                    break
            for control, value in self._before[::-1]:
                restore = partial(self._set, control, value)
                any(self._asked(restore) is not None for _ in range(RESTORE_TRIES))
        finally:
            self.applied.set()
            self._device.close()

    def end(self, wait_s: float) -> None:
        """Restores every changed control, the last one first, as far as the device answers in time."""
        self._ending.set()
        self.join(wait_s)

    def _apply(self) -> None:
        camera = self._camera
        if camera.exposure != "auto":
            self._asked(partial(self._set, AUTO_EXPOSURE, MANUAL_EXPOSURE), "camera.exposure")
            set_exposure = partial(self._set_near, EXPOSURE, "camera.exposure", camera.exposure, EXPOSURE_UNITS_MS, " ms")
            self._asked(set_exposure, "camera.exposure")
        if camera.gain != "auto":
            self._asked(partial(self._set, AUTO_GAIN, 0), "camera.gain")
            self._asked(partial(self._set_near, GAIN, "camera.gain", camera.gain, 1, ""), "camera.gain")
        if camera.power_line_hz != "auto":
            key, entry = "camera.power_line_hz", POWER_LINE_HZ.index(camera.power_line_hz)
            if self._asked(partial(self._set, POWER_LINE, entry), key) is None and not self._noted(key):
                self.notes.append(f"{key} = {camera.power_line_hz}: not supported by the camera")
        if camera.dynamic_framerate != "auto":
            on = int(camera.dynamic_framerate == "on")
            if self._asked(partial(self._set, DYNAMIC_FRAMERATE, on), "camera.dynamic_framerate") and not on:
                self.notes.append(
                    "dynamic frame rate switched off until the end: in dim light the picture is darker instead of slower "
                    "(camera.dynamic_framerate=auto leaves it on)"
                )

    def _noted(self, key: str) -> bool:
        return any(note.startswith(key) for note in self.notes)

    def _asked(self, call: Callable[[], Any], key: str = "") -> Any:
        """The device's answer, None if it fails; notes that under the name key, once."""
        try:
            return call()
        except OSError as error:
            log.info("camera control failed: %s %s", key, reason(error))
            if key and not self._noted(key):
                self.notes.append(f"{key}: the camera does not take it ({reason(error)})")
            return None

    def _set(self, control: int, value: int) -> bool | None:
        """Sets a control to a value in its range. Returns whether that changed it; None if the device has no such value."""
        span = self._device.control_range(control)
        if span is None or not span.minimum <= value <= span.maximum:
            return None
        before = self._device.control(control)
        if before != value:
            self._device.set_control(control, value)
            self._before.append((control, before))
        return before != value

    def _set_near(self, control: int, key: str, value: float, scale: int, unit: str) -> None:
        """Sets a control to the nearest value that it has, and notes how that differs."""
        if (span := self._device.control_range(control)) is None:
            self.notes.append(f"{key} = {value:g}{unit}: the camera has no such control")
            return
        steps = round((value * scale - span.minimum) / span.step)
        nearest = min(max(span.minimum + steps * span.step, span.minimum), span.maximum)
        self._set(control, nearest)
        if abs(nearest - value * scale) > max(span.step, 1) / 2:
            low, high = span.minimum / scale, span.maximum / scale
            self.notes.append(f"{key} = {value:g}{unit}: using {nearest / scale:g} ({low:g} to {high:g}{unit} possible)")

    def _exposure_ns(self) -> int | None:
        known = self._device.control_range(EXPOSURE) is not None
        return (self._device.control(EXPOSURE) * EXPOSURE_UNIT_NS or None) if known else None
