"""Suspends every process and device of the guest for 5 s, with a camera open: run last, because the 9p root does not survive it.

The kernel's suspend test (pm_test = devices) does everything except switch off the processor, which emulated clocks do not wake.

Everything is mapped and locked before; the result goes to the console.
"""

import ctypes
import itertools
import json
import os
import time
from pathlib import Path

import numpy as np

from lfpipe import config
from lfpipe.capture.open_source import open_reconnecting
from lfpipe.capture.reconnecting_camera import ReconnectingCamera
from tests.camera_vm import driver

MARK = "LFPIPE-ASLEEP "
JAIL = Path("/run/jail")
CAMERA = config.Camera(width_px=320, height_px=180, rate_hz=10.0)
MCL_CURRENT, MCL_FUTURE = 1, 2


def measure() -> dict[str, object]:
    """Measures the cost of suspending."""
    driver.unload("vivid")
    vivid = driver.plug()
    camera = open_reconnecting(f"camera:{vivid}", CAMERA)
    assert isinstance(camera, ReconnectingCamera)
    out = np.empty((180, 320, 3), np.uint8)
    driver.cost_of("", camera, 10.0, lambda: driver.inject(vivid, driver.FATAL_ERROR))  # touches the code of a lost camera
    for name in ("dev", "sys", "proc"):  # paths must not lead through the root on 9p any more
        (JAIL / name).mkdir(parents=True)
        driver.call("busybox", "mount", "--bind", f"/{name}", str(JAIL / name))
    os.chroot(JAIL)
    assert ctypes.CDLL(None).mlockall(MCL_CURRENT | MCL_FUTURE) == 0
    last, _ = driver.read(camera, out)
    say({"to": "sleep"})
    began_s = time.monotonic()
    Path("/sys/power/pm_test").write_text("devices")
    Path("/sys/power/state").write_text("mem")
    awake_s = time.monotonic()
    say({"to": "camera"})
    first, lost = driver.read(camera, out)
    first_s = time.monotonic() - awake_s
    later = [driver.read(camera, out)[0] for _ in range(10)]
    steps = sorted(b.t_sensor_ns - a.t_sensor_ns for a, b in itertools.pairwise(later))
    return {
        "away_s": awake_s - began_s,
        "seconds": first_s,
        "lost": lost,
        "frames": first.source_seq - last.source_seq - 1,
        "step_ms": steps[len(steps) // 2] / 1e6,
    }


def say(found: dict[str, object]) -> None:
    os.write(console, f"\r\n{MARK}{json.dumps(found)}\r\n".encode())


if __name__ == "__main__":
    console = os.open("/dev/ttyS0", os.O_WRONLY | os.O_NOCTTY)
    try:
        say(measure())
    except BaseException as error:  # a traceback would read files that are gone after the sleep
        say({"error": repr(error)})
    Path("/proc/sysrq-trigger").write_text("o")  # nor can the shell read the rest of the script that started this
    time.sleep(60)
