"""Exposure, gain and dynamic frame rate of a camera: applied at the start, restored at the end.

A camera may take a second to answer, or never answer. So a thread of its own asks it while frames
are read.
"""

import logging
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from lfpipe import config
from lfpipe.capture.v4l2_device import ControlRange, V4L2Device
from lfpipe.files.safe_files import reason

log = logging.getLogger(__name__)
T = TypeVar("T")

# linux/v4l2-controls.h
AUTO_GAIN, GAIN = 0x00980912, 0x00980913
AUTO_EXPOSURE, EXPOSURE, DYNAMIC_FRAMERATE = 0x009A0901, 0x009A0902, 0x009A0903
CHECK_S = 2.0  # automatic exposure follows the light
RESTORE_TRIES = 3  # a busy camera misses a request; nobody would set the control again
DARKER = (
    "dynamic frame rate switched off until the end: in dim light the picture is darker instead of"
    " slower (camera.dynamic_framerate=auto leaves it on)"
)


# key: its control, steps per unit, unit,
# the control of its automatic, and that one's value for "manual"
AMOUNTS = {
    "camera.exposure": (EXPOSURE, 10, " ms", AUTO_EXPOSURE, 1),
    "camera.gain": (GAIN, 1, "", AUTO_GAIN, 0),
}


def control_texts(device: V4L2Device) -> list[str]:
    """The controls that the device has, with their present values and ranges, for people.

    Raises OSError as the driver does.
    """
    texts = []
    for key, (control, scale, unit, switch, manual) in AMOUNTS.items():
        if (span := device.control_range(control)) is not None:
            automatic = (
                device.control_range(switch) is not None and device.control(switch) != manual
            )
            value, low, high = (
                steps / scale for steps in (device.control(control), span.minimum, span.maximum)
            )
            texts.append(
                f"{key} {value:g}{unit}{' (automatic)' if automatic else ''} [{low:g} to"
                f" {high:g}{unit}]"
            )
    if device.control_range(DYNAMIC_FRAMERATE) is not None:
        texts.append(f"camera.dynamic_framerate {device.control(DYNAMIC_FRAMERATE)} [0 to 1]")
    return texts


class CameraControls(threading.Thread):
    """Applies the configuration to a device, then asks it every CHECK_S; at the end restores the
    old settings and closes it.

    notes: for the user, by key, complete once `applied` is set. exposure_ns: as the camera reports
    it, None if it does not.
    signal: False if nothing is connected to the device's input.
    """

    def __init__(self, device: V4L2Device, camera: config.Camera) -> None:
        """device: open; it belongs to the thread from now on."""
        super().__init__(name="camera-controls", daemon=True)
        self._device = device
        self._camera = camera
        self._before: dict[int, int] = {}
        self._ending = threading.Event()
        self.applied = threading.Event()
        self.notes: dict[str, str] = {}
        self.exposure_ns: int | None = None
        self.signal = True
        self.start()

    def run(self) -> None:
        try:
            self._apply(self._camera)
            while True:
                self.exposure_ns = self._asked("", self._exposure_ns)
                self.signal = self._device.signal
                self.applied.set()
                if self._ending.wait(CHECK_S):
                    break
            for control, value in reversed(self._before.items()):
                any(
                    self._asked("", self._set, control, value) is not None
                    for _ in range(RESTORE_TRIES)
                )
        finally:
            self.applied.set()
            self._device.close()

    def end(self, wait_s: float) -> None:
        """Restores every changed control, the last one first, as far as the device answers
        in time.
        """
        self._ending.set()
        self.join(wait_s)

    def _apply(self, camera: config.Camera) -> None:
        for key, value in ("camera.exposure", camera.exposure), ("camera.gain", camera.gain):
            if value != "auto":
                self._asked(key, self._set_amount, key, value)
        key = "camera.dynamic_framerate"
        state = camera.dynamic_framerate
        if (
            state != "auto"
            and self._asked(key, self._set, DYNAMIC_FRAMERATE, int(state == "on"))
            and state == "off"
        ):
            self.notes[key] = DARKER

    def _asked(self, key: str, call: Callable[..., T | None], *args: Any) -> T | None:
        """The device's answer; if it fails None, which is noted for the key."""
        try:
            return call(*args)
        except OSError as error:
            log.info("camera control failed: %s %s", key, reason(error))
            if key:
                self.notes[key] = f"{key}: the camera does not take it ({reason(error)})"
            return None

    def _set(self, control: int, value: int) -> bool | None:
        """Sets a control to a value in its range.

        Returns whether that changed it; None if the device has no such value.
        """
        span = self._device.control_range(control)
        if span is None or not span.minimum <= value <= span.maximum:
            return None
        before = self._device.control(control)
        if before != value:
            self._device.set_control(control, value)
            self._before.setdefault(control, before)
        return before != value

    def _set_amount(self, key: str, value: float) -> None:
        """Sets one of AMOUNTS to the nearest value that it has, and notes how that differs."""
        control, scale, unit, switch, manual = AMOUNTS[key]
        self._set(switch, manual)
        if (span := self._device.control_range(control)) is None:
            self.notes[key] = f"{key} = {value:g}{unit}: the camera has no such control"
            return
        nearest = _nearest(span, value * scale)
        self._set(control, nearest)
        if abs(nearest - value * scale) > max(span.step, 1) / 2:
            low, high = span.minimum / scale, span.maximum / scale
            self.notes[key] = (
                f"{key} = {value:g}{unit}: using {nearest / scale:g} ({low:g} to {high:g}{unit}"
                " possible)"
            )

    def _exposure_ns(self) -> int | None:
        if self._device.control_range(EXPOSURE) is None:
            return None
        return self._device.control(EXPOSURE) * 100_000 or None  # it counts 0.1 ms


def _nearest(span: ControlRange, value: float) -> int:
    """The value in a range that is nearest to another one."""
    steps = round((value - span.minimum) / span.step)
    last = (span.maximum - span.minimum) // span.step
    return span.minimum + min(max(steps, 0), last) * span.step
