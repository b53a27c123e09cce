"""A network camera: rtsp://HOST/PATH."""

from typing import Self

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.spec import SourceKind
from lfpipe.errors import UserError, redacted
from lfpipe.files.codecs import fitted
from lfpipe.rings import StampKind, now_ns


@attrs.frozen
class RtspSource(SourceKind):
    url: str
    form, live, time_limit_s, remedy = "rtsp://HOST/PATH", True, 15.0, "check the network"

    @classmethod
    def parse(cls, rest: str) -> Self | None:
        return cls(f"rtsp:{rest}") if rest.startswith("//") else None

    def __str__(self) -> str:
        return self.url

    def open(self, camera: config.Camera) -> "Stream":
        return Stream(self.url, camera)


class Stream:
    def __init__(self, url: str, camera: config.Camera) -> None:
        self._capture = cv2.VideoCapture(url)
        if not self._capture.isOpened():
            raise UserError(f"{url}: cannot be opened", "check the URL")
        self._count = 0
        size_px = (camera.width_px, camera.height_px)
        self.info = SourceInfo(redacted(url), size_px, camera.nominal_hz, live=True)

    def read(self, out: NDArray[np.uint8]) -> Frame:
        found, picture = self._capture.read()
        if not found:
            raise UserError(f"{self.info.name}: no more pictures", "check the camera")
        fitted(np.asarray(picture, np.uint8), out)
        self._count += 1
        t_ns = now_ns()
        return Frame(self._count - 1, t_ns, t_ns, stamp=StampKind.READ)

    def close(self) -> None:
        self._capture.release()
