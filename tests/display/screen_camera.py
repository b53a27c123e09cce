"""`lfpipe` with a camera that looks at the X server's screen, with a delay, exposure and readout of its own.

The device's node is an ordinary file: the settings of `Optics` as JSON. Beside it, NODE.truth holds at the end how far the pixels
changed before or after the blanks that the window heard of: fake ones on Xvfb. Used as `python -m tests.display.screen_camera`.
"""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.capture import camera
from lfpipe.capture.v4l2_device import Mode
from lfpipe.capture.v4l2_stream import RawFrame
from tests.faults.scripted_camera import ScriptedDevice

SAMPLE_S, STEP_PX, BANDS = 0.002, 20, 8
WIDTH, HEIGHT = 160, 120


@attrs.frozen
class Optics:
    """buffer: Xvfb's picture of the screen. screen_ms, camera_ms: delays of light and of stamps."""

    buffer: str
    screen_ms: float = 20.0
    camera_ms: float = 20.0
    rate_hz: float = 28.7  # not in step with the screen
    exposure_ms: float = 8.0
    readout_ms: float = 15.0
    gamma: float = 2.2
    noise: float = 2.0


def stamp_offset_ms(optics: Optics) -> float:
    """From the middle of an exposure to the stamp that the product makes of it: a quarter of a period before the end of the
    frame, where the camera does not tell its exposure."""
    return optics.camera_ms - 1e3 / optics.rate_hz / 4 + optics.exposure_ms / 2


class ScreenCamera(ScriptedDevice):
    """Samples the screen on a thread; frames are averages of samples, seen at a slant, a part hidden."""

    def __init__(self, path: Path) -> None:
        self.optics = Optics(**json.loads(path.read_text()))
        data = np.memmap(self.optics.buffer, np.uint8, "r")
        head = np.frombuffer(data[:100].tobytes(), ">u4")
        start, line, height, width = head[0] + 12 * head[19], head[12], head[5], head[4]
        rows = np.lib.stride_tricks.as_strided(data[start:], (height, line), (line, 1))
        self._screen = rows[STEP_PX // 2 :: STEP_PX, 4 * (STEP_PX // 2) : 4 * width : 4 * STEP_PX]
        self.samples: list[tuple[float, np.ndarray]] = []
        self._rng = np.random.default_rng(1)
        self._count, self._due, self._ended = 0, time.monotonic(), threading.Event()
        h, w = self._screen.shape
        to = np.array([[28, 22], [130, 30], [125, 98], [35, 90]], np.float32)
        self._matrix = cv2.getPerspectiveTransform(np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32), to)
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()
        CAMERAS.append(self)

    def _sample(self) -> None:
        while not self._ended.wait(SAMPLE_S):
            before = time.monotonic()
            picture = self._screen.copy()
            self.samples.append(((before + time.monotonic()) / 2, picture))

    def configure(self, fourcc: str, width_px: int, height_px: int, rate_hz: float) -> Mode:
        return Mode("BGR3", WIDTH, HEIGHT, 3 * WIDTH, self.optics.rate_hz)

    def read(self, timeout_s: float) -> RawFrame:
        optics = self.optics
        self._due += 1 / optics.rate_hz
        end, stamp = self._due, self._due + optics.camera_ms / 1e3  # of the exposure of the middle row, and its stamp
        time.sleep(max(0.0, stamp + optics.readout_ms / 2e3 - time.monotonic()))
        recent = self.samples[-400:]
        times = np.array([t for t, _ in recent])
        middles = np.concatenate([times[:1], (times[1:] + times[:-1]) / 2, times[-1:] + SAMPLE_S])
        light = np.empty((HEIGHT, WIDTH), np.float32)
        for band in range(BANDS):
            last = end + ((band + 0.5) / BANDS - 0.5) * optics.readout_ms / 1e3 - optics.screen_ms / 1e3
            edges = np.clip(middles, last - optics.exposure_ms / 1e3, last)
            shares = np.diff(edges)
            seen = sum(share * picture.astype(np.float32) for share, (_, picture) in zip(shares, recent, strict=True) if share)
            seen = np.asarray(seen / max(shares.sum(), 1e-9) / 255, np.float32) * np.ones(self._screen.shape, np.float32)
            rows = slice(band * HEIGHT // BANDS, (band + 1) * HEIGHT // BANDS)
            light[rows] = cv2.warpPerspective(seen, self._matrix, (WIDTH, HEIGHT))[rows]
        light[:, 108:] = 0  # something stands before it
        levels = 255 * (0.05 + 0.6 * light) ** (1 / optics.gamma)
        noise = self._rng.normal(0, optics.noise, (HEIGHT, WIDTH)).astype(np.float32)
        levels += noise
        picture = cv2.cvtColor(np.clip(levels, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)
        self._count += 1
        return RawFrame(picture.reshape(-1), self._count, int(stamp * 1e9), False, False)

    def close(self) -> None:
        self._ended.set()


CAMERAS: list[ScreenCamera] = []


def open_screen(path: Path, settings: config.Camera) -> camera.CameraSource:
    return camera.CameraSource(path, settings, ScreenCamera(path), lambda device: device)


def changed_after_ms(device: ScreenCamera, heard: dict[int, int], shown: dict[int, float]) -> float:
    """How long after its blank a picture of the window was in the screen's memory, mean. Odd pictures are white."""
    times = np.array([t for t, _ in device.samples])
    middle = np.array([picture[picture.shape[0] // 2, picture.shape[1] // 2] > 127 for _, picture in device.samples])
    late = []
    for number, blank_ns in heard.items():
        after = np.nonzero((times > shown[number]) & (middle == (number % 2 == 1)))[0]
        if len(after) and after[0] > 0:
            late.append((times[after[0]] + times[after[0] - 1]) / 2 - blank_ns / 1e9)
    return float(np.mean(late)) * 1e3


def watched(window_class: Any, heard: dict[int, int], shown: dict[int, float]) -> None:
    """Notes when the window hands pictures over and which blanks it hears of."""
    show, presented = window_class.show, window_class.presented

    def noted_show(self: Any, *args: Any) -> int:
        shown[self._number + 1] = time.monotonic()
        return int(show(self, *args))

    def noted_presented(self: Any) -> list[Any]:
        answers = presented(self)
        for answer in answers:
            if answer.t_ns:
                heard.setdefault(answer.serial, answer.t_ns)
        return list(answers)

    window_class.show, window_class.presented = noted_show, noted_presented


if __name__ == "__main__":
    import sys

    from lfpipe.cli import run
    from lfpipe.observe import loop_calibration
    from lfpipe.render.window import Window

    camera.open_camera = open_screen
    loop_calibration.MEASURE_S, loop_calibration.GOOD_MS = 6.0, 2.0  # the whole time is for people and their mirrors
    heard: dict[int, int] = {}
    shown: dict[int, float] = {}
    watched(Window, heard, shown)
    try:
        run()
    finally:
        node = next(word.removeprefix("camera:") for word in sys.argv if word.startswith("camera:"))
        if CAMERAS and heard:
            Path(f"{node}.truth").write_text(json.dumps(changed_after_ms(CAMERAS[0], heard, shown)))
