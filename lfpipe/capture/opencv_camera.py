"""Cameras through OpenCV on macOS (AVFoundation), where we have not tested it.

OpenCV provides no time stamps: a frame's time is the time of reading it. For the list of cameras
see `camera_list`; camera:0 needs none.
"""

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import Frame, SourceInfo, size_notes
from lfpipe.errors import UserError
from lfpipe.files.codecs import fitted
from lfpipe.host.terminal import opencv_logging
from lfpipe.transport.ring import StampKind, now_ns


class OpenCVCamera:
    """An open camera; for the methods see `FrameSource`."""

    def __init__(self, path: Path, camera: config.Camera) -> None:
        """Raises UserError if it cannot be opened or delivers no picture."""
        if not (digits := re.sub(r"\D", "", path.name)):
            raise UserError(
                f"camera {path}: not the number of a camera", "use for example camera:0"
            )
        self._name = f"camera {int(digits)}"
        self._seq = -1
        with opencv_logging():
            self._capture = cv2.VideoCapture(int(digits))
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width_px)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height_px)
        self._capture.set(cv2.CAP_PROP_FPS, camera.highest_hz)
        whole, frame = self._capture.read() if self._capture.isOpened() else (False, None)
        if not whole or frame is None:
            self.close()
            remedy = (
                "close the program that uses it, and allow cameras in the system's privacy settings"
            )
            raise UserError(f"{self._name}: cannot be opened, or delivers no picture", remedy)
        size_px = frame.shape[1::-1]
        rate_hz = float(self._capture.get(cv2.CAP_PROP_FPS)) or camera.nominal_hz
        notes = [
            "OpenCV gives no time stamps: using the time of reading",
            *size_notes(size_px, camera),
        ]
        self.info = SourceInfo(f"camera:{path}", size_px, rate_hz, live=True, notes=tuple(notes))

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`.

        Raises UserError if the camera is gone; may block for as long as its driver does.
        """
        whole, frame = self._capture.read()
        if not whole:
            raise UserError(f"{self._name}: delivers no more pictures", "plug it in again")
        t_ns = now_ns()
        self._seq += 1
        fitted(np.asarray(frame, np.uint8), out)
        return Frame(self._seq, t_ns, t_ns, None, StampKind.READ)

    def close(self) -> None:
        """Releases the camera."""
        self._capture.release()


open_camera = OpenCVCamera


def check_camera(path: Path, camera: config.Camera) -> SourceInfo:
    """Detects the format that the camera delivers, which starts it.

    Raises UserError as `OpenCVCamera` does.
    """
    opened = OpenCVCamera(path, camera)
    opened.close()
    return opened.info
