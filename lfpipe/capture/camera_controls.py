"""Exposure, gain, mains frequency and dynamic frame rate of a camera: applied at the start, restored at the end.

A camera may take a second to answer, or never answer. So a thread of its own asks it while frames are read.
"""

import logging
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import attrs

from lfpipe import config
from lfpipe.capture.v4l2_device import ControlRange
from lfpipe.files.safe_files import reason

log = logging.getLogger(__name__)

# linux/v4l2-controls.h
AUTO_GAIN, GAIN, POWER_LINE = 0x00980912, 0x00980913, 0x00980918
AUTO_EXPOSURE, EXPOSURE, DYNAMIC_FRAMERATE = 0x009A0901, 0x009A0902, 0x009A0903
MANUAL_EXPOSURE = 1
EXPOSURE_UNITS_MS = 10  # EXPOSURE counts 0.1 ms
POWER_LINE_HZ = {0: 0, 50: 1, 60: 2}
CHECK_S = 2.0  # automatic exposure follows the light


class Controls(Protocol):
    """The part of `V4L2Device` in use here."""

    @property
    def signal(self) -> bool: ...
    def control_range(self, control: int) -> ControlRange | None: ...
    def control(self, control: int) -> int: ...
    def set_control(self, control: int, value: int) -> None: ...
    def close(self) -> None: ...


@attrs.frozen
class ControlState:
    """A control for people. key: in the configuration. value, low, high: in unit, "" for the driver's own."""

    key: str
    value: float
    low: float
    high: float
    unit: str
    automatic: bool  # currently set by the camera

    @property
    def text(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.key} {self.value:g}{unit}{' (automatic)' if self.automatic else ''} [{self.low:g} to {self.high:g}{unit}]"


_AUTOMATICS: tuple[tuple[str, int, int, str, int, Callable[[int], bool]], ...] = (
    ("camera.exposure", EXPOSURE, EXPOSURE_UNITS_MS, "ms", AUTO_EXPOSURE, lambda value: value != MANUAL_EXPOSURE),
    ("camera.gain", GAIN, 1, "", AUTO_GAIN, bool),
)


def control_states(device: Controls) -> list[ControlState]:
    """The controls that the device has, with their present values and ranges. Raises OSError as the driver does."""
    states = []
    for key, control, scale, unit, switch, is_auto in _AUTOMATICS:
        if (span := device.control_range(control)) is not None:
            automatic = device.control_range(switch) is not None and is_auto(device.control(switch))
            low, high, value = span.minimum / scale, span.maximum / scale, device.control(control) / scale
            states.append(ControlState(key, value, low, high, unit, automatic))
    if (span := device.control_range(POWER_LINE)) is not None:
        value = device.control(POWER_LINE)
        hz = next((hz for hz, menu in POWER_LINE_HZ.items() if menu == value), 0)
        states.append(ControlState("camera.power_line_hz", hz, 0, 60 if span.maximum > 1 else 50, "Hz", value > 2))
    if device.control_range(DYNAMIC_FRAMERATE) is not None:
        states.append(ControlState("camera.dynamic_framerate", device.control(DYNAMIC_FRAMERATE), 0, 1, "", False))
    return states


class CameraControls(threading.Thread):
    """Applies the configuration to a device, then asks it every CHECK_S; at the end restores the old settings and closes it.

    notes: for the user, complete once `applied` is set. exposure_ns: as the camera reports it, None if it does not. signal: False
    if nothing is connected to the device's input.
    """

    def __init__(self, device: Controls, camera: config.Camera) -> None:
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
                self.exposure_ns, self.signal = self._exposure_ns(), self._device.signal
                self.applied.set()
                if self._ending.wait(CHECK_S):
                    break
            for control, value in reversed(self._before):
                self._asked(partial(self._device.set_control, control, value), "")
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
            self._set(AUTO_EXPOSURE, MANUAL_EXPOSURE, "camera.exposure")
            self._set_in_range(EXPOSURE, "camera.exposure", camera.exposure, EXPOSURE_UNITS_MS, " ms")
        if camera.gain != "auto":
            self._set(AUTO_GAIN, 0, "camera.gain")
            self._set_in_range(GAIN, "camera.gain", camera.gain, 1, "")
        if camera.power_line_hz != "auto":
            key = "camera.power_line_hz"
            if self._set(POWER_LINE, POWER_LINE_HZ[camera.power_line_hz], key) is None:
                self.notes.append(f"{key} = {camera.power_line_hz}: not supported by the camera")
        if camera.dynamic_framerate != "auto":
            on = int(camera.dynamic_framerate == "on")
            if self._set(DYNAMIC_FRAMERATE, on, "camera.dynamic_framerate") and not on:
                self.notes.append(
                    "dynamic frame rate switched off until the end: in dim light the picture is darker instead of slower "
                    "(camera.dynamic_framerate=auto leaves it on)"
                )

    def _asked(self, call: Callable[[], Any], key: str) -> Any:
        """The device's answer, None if it fails; notes that under the name key."""
        try:
            return call()
        except OSError as error:
            log.info("camera control failed: %s %s", key, reason(error))
            if key:
                self.notes.append(f"{key}: the camera does not take it ({reason(error)})")
            return None

    def _set(self, control: int, value: int, key: str) -> bool | None:
        """Sets a control to a value in its range. Returns whether that changed it; None if the device lacks or refuses it."""

        def change() -> bool | None:
            span = self._device.control_range(control)
            if span is None or not span.minimum <= value <= span.maximum:
                return None
            before = self._device.control(control)
            if before != value:
                self._device.set_control(control, value)
                self._before.append((control, before))
            return before != value

        count = len(self.notes)
        changed: bool | None = self._asked(change, key)
        return False if changed is None and len(self.notes) > count else changed

    def _set_in_range(self, control: int, key: str, wanted: float, scale: int, unit: str) -> None:
        count = len(self.notes)
        span: ControlRange | None = self._asked(lambda: self._device.control_range(control), key)
        if span is None:
            if len(self.notes) == count:
                self.notes.append(f"{key} = {wanted:g}{unit}: the camera has no such control")
            return
        steps = round((wanted * scale - span.minimum) / span.step)
        value = min(max(span.minimum + steps * span.step, span.minimum), span.maximum)
        if self._set(control, value, key) is not None and abs(value - wanted * scale) > max(span.step, 1) / 2:
            low, high = span.minimum / scale, span.maximum / scale
            self.notes.append(f"{key} = {wanted:g}{unit}: using {value / scale:g} ({low:g} to {high:g}{unit} possible)")

    def _exposure_ns(self) -> int | None:
        def ask() -> int:
            return self._device.control(EXPOSURE) if self._device.control_range(EXPOSURE) is not None else 0

        return int(self._asked(ask, "") or 0) * 100_000 or None
