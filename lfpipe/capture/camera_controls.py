"""Exposure, gain, mains frequency and dynamic frame rate of a camera: applied at the start, restored at the end."""

import contextlib
from typing import Protocol

import attrs

from lfpipe import config
from lfpipe.capture.v4l2_device import ControlRange

# linux/v4l2-controls.h
AUTO_GAIN, GAIN, POWER_LINE = 0x00980912, 0x00980913, 0x00980918
AUTO_EXPOSURE, EXPOSURE, DYNAMIC_FRAMERATE = 0x009A0901, 0x009A0902, 0x009A0903
MANUAL_EXPOSURE = 1
EXPOSURE_UNITS_MS = 10  # EXPOSURE counts 0.1 ms
POWER_LINE_HZ = {0: 0, 50: 1, 60: 2}


class Controls(Protocol):
    """The part of `V4L2Device` in use here."""

    def control_range(self, control: int) -> ControlRange | None: ...
    def control(self, control: int) -> int: ...
    def set_control(self, control: int, value: int) -> None: ...


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


def control_states(device: Controls) -> list[ControlState]:
    """The controls that the device has, with their present values and ranges. Raises OSError as the driver does."""
    found = []
    for key, control, scale, unit, auto in (
        ("camera.exposure", EXPOSURE, EXPOSURE_UNITS_MS, "ms", (AUTO_EXPOSURE, lambda value: value != MANUAL_EXPOSURE)),
        ("camera.gain", GAIN, 1, "", (AUTO_GAIN, bool)),
    ):
        if (span := device.control_range(control)) is not None:
            switch, is_auto = auto
            automatic = device.control_range(switch) is not None and is_auto(device.control(switch))
            low, high, value = span.minimum / scale, span.maximum / scale, device.control(control) / scale
            found.append(ControlState(key, value, low, high, unit, automatic))
    if (span := device.control_range(POWER_LINE)) is not None:
        value = device.control(POWER_LINE)
        hz = next((hz for hz, menu in POWER_LINE_HZ.items() if menu == value), 0)
        found.append(ControlState("camera.power_line_hz", hz, 0, 60 if span.maximum > 1 else 50, "Hz", value > 2))
    if device.control_range(DYNAMIC_FRAMERATE) is not None:
        found.append(ControlState("camera.dynamic_framerate", device.control(DYNAMIC_FRAMERATE), 0, 1, "", False))
    return found


def exposure_ns(device: Controls) -> int | None:
    """The exposure time as the camera reports it; None if it does not."""
    try:
        if device.control_range(EXPOSURE) is None:
            return None
        value = device.control(EXPOSURE)
    except OSError:
        return None
    return value * 100_000 if value > 0 else None


class CameraControls:
    """Applies the configuration to a device and remembers the old settings. notes: for the user."""

    def __init__(self, device: Controls, camera: config.Camera) -> None:
        self._device = device
        self._before: list[tuple[int, int]] = []
        self.notes: list[str] = []
        if camera.exposure != "auto":
            self._set(AUTO_EXPOSURE, MANUAL_EXPOSURE)
            self._set_in_range(EXPOSURE, "camera.exposure", camera.exposure, EXPOSURE_UNITS_MS, " ms")
        if camera.gain != "auto":
            self._set(AUTO_GAIN, 0)
            self._set_in_range(GAIN, "camera.gain", camera.gain, 1, "")
        if camera.power_line_hz != "auto" and not self._set(POWER_LINE, POWER_LINE_HZ[camera.power_line_hz]):
            self.notes.append(f"camera.power_line_hz = {camera.power_line_hz}: not supported by the camera")
        if camera.dynamic_framerate != "auto":
            wanted = int(camera.dynamic_framerate == "on")
            if self._set(DYNAMIC_FRAMERATE, wanted) and self._before[-1:] == [(DYNAMIC_FRAMERATE, 1 - wanted)] and not wanted:
                self.notes.append(
                    "dynamic frame rate switched off until the end: in dim light the picture is darker instead of slower "
                    "(camera.dynamic_framerate=auto leaves it on)"
                )

    def _set(self, control: int, value: int) -> bool:
        """Sets a control, if the device has it, to a value in its range; returns whether it now has that value."""
        with contextlib.suppress(OSError):
            span = self._device.control_range(control)
            if span is None or not span.minimum <= value <= span.maximum:
                return False
            before = self._device.control(control)
            if before != value:
                self._device.set_control(control, value)
                self._before.append((control, before))
            return True
        return False

    def _set_in_range(self, control: int, key: str, wanted: float, scale: int, unit: str) -> None:
        with contextlib.suppress(OSError):
            span = self._device.control_range(control)
            if span is None:
                self.notes.append(f"{key} = {wanted:g}{unit}: the camera has no such control")
                return
            steps = round((wanted * scale - span.minimum) / span.step)
            value = min(max(span.minimum + steps * span.step, span.minimum), span.maximum)
            if not self._set(control, value):
                self.notes.append(f"{key} = {wanted:g}{unit}: refused by the camera")
            elif abs(value - wanted * scale) > max(span.step, 1) / 2:
                low, high = span.minimum / scale, span.maximum / scale
                self.notes.append(f"{key} = {wanted:g}{unit}: using {value / scale:g} ({low:g} to {high:g}{unit} possible)")

    def restore(self) -> None:
        """Restores every changed control, the last one first, as far as the device still answers."""
        while self._before:
            control, value = self._before.pop()
            with contextlib.suppress(OSError):
                self._device.set_control(control, value)
