"""A camera source that takes 10 s to open, in native code that returns to Python all the time."""

import time
from pathlib import Path
from typing import Self

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.capture.frame_source import FrameSource
from lfpipe.capture.spec import SourceKind
from lfpipe.errors import UserError

ENTRY_POINT = "[lfpipe.sources]\nslow = tests.support.slow_source:SlowSource\n"


@attrs.frozen
class SlowSource(SourceKind):
    """Creates the file that its name tells when it begins."""

    path: Path

    form = "slow:FILE"

    @classmethod
    def parse(cls, rest: str) -> Self:
        return cls(Path(rest))

    def open(self, camera: config.Camera) -> FrameSource:
        self.path.touch()
        picture = np.zeros((64, 64, 3), np.uint8)
        end = time.monotonic() + 10
        while time.monotonic() < end:
            cv2.GaussianBlur(picture, (5, 5), 1.0)
        raise UserError("the slow source is open", "interrupt it")
