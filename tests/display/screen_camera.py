"""`lfpipe` with a camera that looks at the screen, with a delay and an exposure of its own.

The device's node is an ordinary file: the settings of `Optics` as JSON. At each vblank, the screen
shows what the picture of Xvfb held just before, as a real screen would: the server, which has none,
changes its picture 0 to 25 ms before the vblank that it reports. Used as `python -m
tests.display.screen_camera`.
"""

import json
import threading
import time
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.capture import camera as driver
from lfpipe.capture.v4l2_device import Mode, RawFrame
from tests.faults.scripted_camera import ScriptedDevice

SAMPLE_S, STEP_PX = 0.002, 20
XVFB_HZ, MIN_HEARD, MAX_GAP_S = 60, 5, 0.008
WIDTH, HEIGHT = 160, 120
NOISE = 2.0


@attrs.frozen
class Optics:
    """buffer: file of Xvfb's picture of the screen. screen_ms, camera_ms: delays of light and
    stamps.
    """

    buffer: str
    screen_ms: float = 20.0
    camera_ms: float = 20.0
    rate_hz: float = 28.7  # not in step with the screen
    exposure_ms: float = 8.0


def stamp_offset_ms(optics: Optics) -> float:
    """From the middle of an exposure to the stamp that the product makes of it: a quarter of a
    period before the end of the frame, where the camera does not tell its exposure.
    """
    return optics.camera_ms - 1e3 / optics.rate_hz / 4 + optics.exposure_ms / 2


class ScreenCamera(ScriptedDevice):
    """Samples the screen on a thread; a frame is the mean of what the screen showed during its
    exposure.
    """

    def __init__(self, path: Path) -> None:
        self.optics = Optics(**json.loads(path.read_text()))
        self.samples: list[tuple[float, np.ndarray]] = []
        self._rng = np.random.default_rng(1)
        self._count = 0
        self._due = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()
        while not self.samples:
            time.sleep(SAMPLE_S)

    def _sample(self) -> None:
        data = np.memmap(self.optics.buffer, np.uint8, "r")
        head = np.frombuffer(data[:100].tobytes(), ">u4")
        start, line, height, width = head[0] + 12 * head[19], head[12], head[5], head[4]
        rows = np.lib.stride_tricks.as_strided(data[start:], (height, line), (line, 1))
        screen = rows[STEP_PX // 2 :: STEP_PX, 4 * (STEP_PX // 2) : 4 * width : 4 * STEP_PX, None]
        while not self._ended.wait(SAMPLE_S):
            self.samples.append((time.monotonic(), screen.copy()))

    def _shown(self) -> list[tuple[float, np.ndarray]]:
        """Since when the screen has shown what, of the last second."""
        recent = self.samples[-400:]
        if len(HEARD) < MIN_HEARD:
            return recent
        heard = np.array(sorted(HEARD.values())[-60:]) / 1e9
        slope, first = np.polyfit(np.round((heard - heard[-1]) * XVFB_HZ), heard - heard[-1], 1)
        times = np.array([t for t, _ in recent])
        count = np.arange(
            np.ceil((times[0] - heard[-1] - first) / slope),
            (times[-1] - heard[-1] - first) // slope + 1,
        )
        vblanks = heard[-1] + first + slope * count
        return [
            (float(t), recent[k][1])
            for t, k in zip(vblanks, np.searchsorted(times, vblanks) - 1, strict=True)
        ]

    def _saw_all(self, from_s: float, to_s: float) -> bool:
        """Whether no change of the screen can have been overlooked in that time."""
        times = np.array([t for t, _ in self.samples[-400:]])
        gaps = np.diff(times)
        near = (times[1:] > from_s) & (times[:-1] < to_s)
        return bool(
            times[0] < from_s
            and gaps[near].max(initial=0.0) < max(MAX_GAP_S, 1.6 * np.median(gaps))
        )

    def configure(self, fourcc: str, width_px: int, height_px: int, rate_hz: float) -> Mode:
        return Mode("BGR3", WIDTH, HEIGHT, 3 * WIDTH, self.optics.rate_hz)

    def start(self) -> None: ...

    def read(self, timeout_s: float) -> RawFrame:
        optics = self.optics
        until = time.monotonic() + timeout_s
        while True:
            if time.monotonic() > until:
                raise TimeoutError
            behind = int(
                max(time.monotonic() - self._due - optics.camera_ms / 1e3, 0) * optics.rate_hz
            )
            # frames that nobody fetched in time are lost
            self._due += (1 + behind) / optics.rate_hz
            self._count += 1 + behind
            # of the exposure; its stamp
            end = self._due - optics.screen_ms / 1e3
            stamp = self._due + optics.camera_ms / 1e3
            time.sleep(max(0.0, stamp - time.monotonic()))
            if self._saw_all(end - optics.exposure_ms / 1e3, end):
                break  # a busy machine left gaps: such a frame is lost, too
        recent = self._shown()
        since = np.array([*(t for t, _ in recent), time.monotonic()])
        shares = np.diff(np.clip(since, end - optics.exposure_ms / 1e3, end))
        light = sum(shares[k] * recent[k][1].astype(float) for k in np.nonzero(shares)[0]) / max(
            shares.sum(), 1e-9
        )
        levels = (
            13
            + 0.6 * cv2.resize(np.asarray(light), (WIDTH, HEIGHT))
            + self._rng.normal(0, NOISE, (HEIGHT, WIDTH))
        )
        grey = np.clip(levels, 0, 255).astype(np.uint8)
        return RawFrame(
            data=grey.repeat(3),
            sequence=self._count,
            stamp_ns=int(stamp * 1e9),
            start_of_exposure=False,
            damaged=False,
        )

    def close(self) -> None:
        self._ended.set()


def open_screen(path: Path, camera: config.Camera) -> driver.CameraSource:
    return driver.CameraSource(path, camera, ScreenCamera(path))


HEARD: dict[int, int] = {}  # vblanks reported to the window, ns, by picture


def note_vblanks(window_class: Any) -> None:
    presented = window_class.presented

    def noted(self: Any) -> list[Any]:
        answers = presented(self)
        HEARD.update((answer.serial, answer.t_ns) for answer in answers if answer.t_ns)
        return list(answers)

    window_class.presented = noted


if __name__ == "__main__":
    from lfpipe.cli import run
    from lfpipe.render.display.window import ScreenWindow
    from tests.display import screen_camera

    driver.open_camera = screen_camera.open_screen
    screen_camera.note_vblanks(ScreenWindow)
    run()
