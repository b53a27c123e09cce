"""The guest's drivers: vivid with its injected faults, and what a fault costs."""

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lfpipe.capture.frame_source import Frame
from lfpipe.capture.open_source import CameraLost, ReconnectingCamera
from lfpipe.capture.v4l2_device import V4L2Device
from lfpipe.errors import UserError
from tests.support.world import until

MODULES = Path("/run/modules")
OWN = ("vivid", "vhci-hcd", "uvcvideo")  # loaded by the tests that need them
# drivers/media/test-drivers/vivid/vivid-ctrls.c
TIMESTAMP_SOURCE, OSD_TEXT, SIGNAL_MODE = 0x00F0F018, 0x00F0F001, 0x00F0F03E
DROPPED_PERCENT = 0x00F0F040
DISCONNECT = 0x00F0F041
BUFFER_ERROR = 0x00F0F042
REQBUFS_ERROR = 0x00F0F043
QBUF_ERROR, STREAMON_ERROR, FATAL_ERROR = 0x00F0F044, 0x00F0F045, 0x00F0F046


def call(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{words}: {done.stderr}"


def load(module: str, *parameters: str) -> None:
    """Loads a module, unless it is loaded, after the ones it needs."""
    loaded = Path("/proc/modules").read_text()
    needed = [
        name
        for name in (MODULES / "camera.list").read_text().split()
        if name.removesuffix(".ko") not in OWN
    ]
    for name in (*needed, f"{module}.ko"):
        if f"{name.removesuffix('.ko').replace('-', '_')} " not in loaded:
            call(
                "busybox",
                "insmod",
                str(MODULES / name),
                *(parameters if name == f"{module}.ko" else ()),
            )


def unload(module: str, limit_s: float = 20.0) -> None:
    """Unloads a module as soon as it is unused."""
    until = time.monotonic() + limit_s
    while f"{module} " in Path("/proc/modules").read_text():
        done = subprocess.run(
            ("busybox", "rmmod", module), capture_output=True, text=True, check=False
        )
        assert time.monotonic() < until, done.stderr
        time.sleep(0.1)


def plug(number: int = 0, *more: str) -> Path:
    """A vivid camera at /dev/video{number}; its only input is a webcam."""
    load(
        "vivid",
        "n_devs=1",
        "node_types=0x1",
        f"vid_cap_nr={number}",
        *(more or ("num_inputs=1", "input_types=0")),
    )
    path = Path(f"/dev/video{number}")
    until(path.exists, str(path))
    inject(path, OSD_TEXT, 2)
    return path


def inject(path: Path, control: int, value: int = 1) -> None:
    """Sets a control of vivid through another descriptor, like another program."""
    device = V4L2Device(path)
    try:
        device.set_control(control, value)
    finally:
        device.close()


def read(camera: ReconnectingCamera, out: np.ndarray, limit_s: float = 30.0) -> tuple[Frame, bool]:
    """The next frame, and whether the camera was lost before it."""
    until = time.monotonic() + limit_s
    lost = False
    while time.monotonic() < until:
        try:
            frame = camera.read(out)
        except CameraLost:
            lost = True
        except (TimeoutError, UserError):
            pass
        else:
            assert frame is not None
            return frame, lost
    raise AssertionError(f"no frame for {limit_s} s")


def after(
    act: Callable[[], None], camera: ReconnectingCamera, rate_hz: float, frames: int = 10
) -> tuple[int, bool]:
    """What a fault between frames costs: (frames that are missing among the next ones, whether the
    camera counts as lost).
    """
    out = np.empty((180, 320, 3), np.uint8)
    for _ in range(5):
        last, _ = read(camera, out)
    act()
    lost, missing = False, 0
    for _ in range(frames):
        frame, lost_now = read(camera, out)
        lost |= lost_now
        gap = round((frame.t_sensor_ns - last.t_sensor_ns) / 1e9 * rate_hz) - 1
        if gap > 0 and (lost_now or frame.source_seq > last.source_seq + 1):
            missing += gap
        last = frame
    return missing, lost
