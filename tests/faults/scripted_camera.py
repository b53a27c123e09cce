"""`lfpipe` with a camera controlled by a file: everything above the driver is the product's own
code.

The device's node is an ordinary file that holds a word: "frames", "empty" (frames with nobody in
them), "stall" (the driver waits a second and has nothing) or "hang" (a call does not come back). No
file: the camera is unplugged. Used as `python -m tests.faults.scripted_camera up ...`.
"""

import errno
import sys
import time
from pathlib import Path

import attrs
import numpy as np

from lfpipe import config
from lfpipe.capture import camera as driver
from lfpipe.capture import stage
from lfpipe.capture.frame_source import SourceInfo
from lfpipe.capture.recordings import DemoSource
from lfpipe.capture.v4l2_device import ControlRange, FrameSizes, Mode, RawFrame, V4L2Device
from lfpipe.host.worker import serve
from lfpipe.supervisor import process_table
from lfpipe.transport.context import Context


class NoControls(V4L2Device):
    """The controls of a camera that has none."""

    signal = True

    def __init__(self) -> None: ...

    def control_range(self, control: int) -> ControlRange | None:
        return None

    def control(self, control: int) -> int:
        return 0

    def set_control(self, control: int, value: int) -> None: ...

    def close(self) -> None: ...


class ScriptedDevice(NoControls):
    """A `V4L2Device` and its `V4L2Stream`: a camera of 640x480 at 30 Hz with the demo's face before
    it.
    """

    driver = "scripted"
    captures = True

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise FileNotFoundError(errno.ENOENT, "no such device")
        self._path = path
        self._scene = DemoSource(config.Camera())
        self._due = time.monotonic()
        self._picture = np.empty((480, 640, 3), np.uint8)
        self._count = 0

    def _word(self) -> str:
        try:
            return self._path.read_text()
        except FileNotFoundError:
            return ""

    def fourccs(self) -> list[str]:
        return ["BGR3"]

    def sizes(self, fourcc: str) -> list[FrameSizes]:
        return []

    def duplicate(self) -> "NoControls":
        return NoControls()

    def configure(self, fourcc: str, width_px: int, height_px: int, rate_hz: float) -> Mode:
        return Mode("BGR3", 640, 480, 1920, 30.0)

    def start(self) -> None: ...

    def read(self, timeout_s: float) -> RawFrame:
        while self._word() == "hang":
            time.sleep(0.01)
        if self._word() == "stall":
            time.sleep(1.0)
            raise TimeoutError
        self._due = max(self._due + 1 / 30, time.monotonic() - 1 / 30)
        time.sleep(max(0.0, self._due - time.monotonic()))
        word = self._word()
        if word not in ("frames", "empty"):
            raise OSError(errno.ENODEV, "unplugged")
        self._scene.read(self._picture)
        if word == "empty":
            self._picture[:] = 90
        self._count += 1
        return RawFrame(
            data=self._picture.reshape(-1),
            sequence=self._count,
            stamp_ns=time.monotonic_ns(),
            start_of_exposure=False,
            damaged=False,
        )

    def close(self) -> None:
        while self._word() == "hang":
            time.sleep(0.01)


def open_scripted(path: Path, camera: config.Camera) -> driver.CameraSource:
    try:
        device = ScriptedDevice(path)
    except OSError as error:
        raise driver.trouble(path, error) from None
    return driver.CameraSource(path, camera, device)


def check_scripted(path: Path, camera: config.Camera) -> SourceInfo:
    source = open_scripted(path, camera)
    source.close()
    return source.info


def install() -> None:
    driver.open_camera, driver.check_camera = open_scripted, check_scripted


def main(context: Context) -> None:
    install()
    stage.main(context)


if __name__ == "__main__":
    install()
    if len(sys.argv) == 1:  # the child that `up` starts
        from lfpipe.cli import prepare

        serve(prepare.work, 1 << 40)
    process_table.STAGES = tuple(
        attrs.evolve(each, module="tests.faults.scripted_camera")
        if each.name == "capture"
        else each
        for each in process_table.STAGES
    )
    from lfpipe.cli import run, sessions

    sessions.PREPARER = "tests.faults.scripted_camera"
    run()
