"""A V4L2 device and its stream in memory; the test scripts modes, failures and stamps.

The real driver: tests/camera_vm.
"""

import errno
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.camera import CameraSource
from lfpipe.capture.v4l2_device import (
    ControlRange,
    FrameSizes,
    Mode,
    RawFrame,
    V4L2Device,
)

PATH = Path("/dev/null")


@attrs.define
class FakeControl:
    low: int
    high: int
    value: int
    step: int = 1


class FakeCamera(V4L2Device):
    """mode: what `configure` answers; None: the mode that was requested. frames: what comes, in
    turn: bytes or an exception; then the last one for ever. offered: its formats with their sizes
    and rates. slow_s: how long a control takes to answer. refused: controls that cannot be set.

    Frame k has sequence k and a stamp age_s before its reading.
    """

    driver = "fake"
    captures = True
    signal = True

    def __init__(
        self,
        mode: Mode | None = None,
        frames: Iterable[bytes | Exception] = (),
        offered: Iterable[str | FrameSizes] = ("YUYV", "MJPG"),
        controls: dict[int, FakeControl] | None = None,
    ) -> None:
        self.mode = mode or Mode("YUYV", 640, 480, 1280, 30.0)
        self.frames = list(frames) or [
            bytes([9, 128] * (self.mode.stride // 2 * self.mode.height_px))
        ]
        self.offered = list(offered)
        self.controls = controls or {}
        self.requested: list[tuple[object, ...]] = []
        self.slow_s = 0.0
        self.refused = set[int]()
        self.sequences: list[int] = []  # of the frames to come; empty: counting
        self.age_s = 0.005
        self.start_of_exposure = False
        self.damaged = False
        self.closed = 0
        self.sent = 0

    def fourccs(self) -> list[str]:
        return list(
            dict.fromkeys(each if isinstance(each, str) else each.fourcc for each in self.offered)
        )

    def sizes(self, fourcc: str) -> list[FrameSizes]:
        return [
            each for each in self.offered if isinstance(each, FrameSizes) and each.fourcc == fourcc
        ]

    def duplicate(self) -> "FakeCamera":
        return self

    def configure(self, fourcc: str, width_px: int, height_px: int, rate_hz: float) -> Mode:
        self.requested.append((fourcc, width_px, height_px, rate_hz))
        return self.mode

    def control_range(self, control: int) -> ControlRange | None:
        time.sleep(self.slow_s)
        known = self.controls.get(control)
        return None if known is None else ControlRange(known.low, known.high, known.step)

    def control(self, control: int) -> int:
        if control not in self.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        return self.controls[control].value

    def set_control(self, control: int, value: int) -> None:
        if control in self.refused:
            raise OSError(errno.EIO, "Input/output error")
        self.controls[control].value = value

    def start(self) -> None: ...

    def read(self, timeout_s: float) -> RawFrame:
        self.timeout_s = timeout_s
        item = self.frames.pop(0) if len(self.frames) > 1 else self.frames[0]
        if isinstance(item, Exception):
            raise item
        sequence = self.sequences.pop(0) if self.sequences else self.sent
        self.sent += 1
        data: NDArray[np.uint8] = np.frombuffer(item, np.uint8)
        stamp_ns = time.monotonic_ns() - int(self.age_s * 1e9)
        return RawFrame(
            data=data,
            sequence=sequence,
            stamp_ns=stamp_ns,
            start_of_exposure=self.start_of_exposure,
            damaged=self.damaged,
        )

    def close(self) -> None:
        self.closed += 1


def source(device: FakeCamera, **settings: Any) -> CameraSource:
    """The product's camera on device."""
    return CameraSource(PATH, attrs.evolve(config.Camera(), **settings), device)
