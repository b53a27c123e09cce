"""`lfpipe` with a camera that does what a file says: everything above the driver is the product's own.

The device's node is an ordinary file that holds a word: "frames", "stall" (the driver waits a second and has nothing) or "hang"
(a call does not come back). No file: the camera is unplugged. Used as `python -m tests.faults.scripted_camera up ...`.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import attrs
import cv2

from lfpipe import config
from lfpipe.capture import camera, stage
from lfpipe.capture.demo import DemoSource
from lfpipe.capture.spec import CameraSpec
from lfpipe.errors import UserError
from lfpipe.supervisor import process_table
from lfpipe.transport.context import Context

ANSWERS = {
    cv2.CAP_PROP_FRAME_WIDTH: 640.0,
    cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
    cv2.CAP_PROP_FPS: 30.0,
    cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"YUYV")),
}


class ScriptedDevice:
    """What is used of cv2.VideoCapture, of a camera of 640x480 at 30 Hz with the demo's face before it."""

    def __init__(self, path: Path) -> None:
        self._path, self._scene, self._due = path, DemoSource(config.Camera()), time.monotonic()

    def _word(self) -> str:
        try:
            return self._path.read_text()
        except FileNotFoundError:
            return ""

    def set(self, propId: int, value: float) -> bool:
        return True

    def get(self, propId: int) -> float:
        return time.monotonic() * 1000 if propId == cv2.CAP_PROP_POS_MSEC else ANSWERS[propId]

    def grab(self) -> bool:
        while self._word() == "hang":
            time.sleep(0.01)
        if self._word() == "stall":
            time.sleep(1.0)
            return False
        self._due = max(self._due + 1 / 30, time.monotonic() - 1 / 30)
        time.sleep(max(0.0, self._due - time.monotonic()))
        return self._word() == "frames"

    def retrieve(self, image: Any = None) -> tuple[bool, Any]:
        self._scene.read(image)
        return True, image

    def release(self) -> None:
        while self._word() == "hang":
            time.sleep(0.01)


def open_scripted(spec: CameraSpec, settings: config.Camera) -> camera.CameraSource:
    if not spec.path.exists():
        raise UserError(f"camera {spec.path}: no such device", "plug it in")
    return camera.CameraSource(spec.path, settings, ScriptedDevice(spec.path))


def main(context: Context) -> None:
    camera.open_camera = open_scripted
    stage.main(context)


if __name__ == "__main__":
    camera.open_camera = open_scripted
    process_table.STAGES = tuple(
        attrs.evolve(each, module="tests.faults.scripted_camera") if each.source else each for each in process_table.STAGES
    )
    from lfpipe.cli import run

    run()
