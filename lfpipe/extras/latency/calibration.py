"""Measures the device latency.

A window flips between black and white, the camera watches it, and `device_latency` compares.
"""

import threading
from contextlib import closing

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import FrameSource, as_read
from lfpipe.capture.open_source import camera_settings, open_source
from lfpipe.config import Config
from lfpipe.errors import UserError
from lfpipe.extras.latency.estimate import (
    AREA_R,
    MIN_FRAMES,
    MIN_PIXELS,
    SPAN,
    LoopDelay,
    Recording,
    estimate,
    find_area,
)
from lfpipe.files.codecs import BrokenFrame
from lfpipe.render.display.display import Overlay, has_display
from lfpipe.render.display.refresh import ScreenClock
from lfpipe.render.display.window_system import Monitor
from lfpipe.transport.ring import MS_NS, SECOND_NS, StampKind, now_ns, sleep_until

WINDOW_PX = (1600, 900)  # limited by the screen
HOLDS = (3, 6)  # of a level, 50 to 100 ms: in refreshes at about STEP_HZ, inclusive
AIM_S = 60.0  # timeout for aiming the camera
# the last of the camera's pictures that are searched for the screen; how often
LOOK_S, LOOK_EVERY_S = 3.0, 1.5
CLEAR_R = 0.4  # of the best pixel within LOOK_S; pure noise reaches 0.3
MEASURE_S = 15.0  # as the recordings of profiling/photon.py, which states the errors
EVENTS_NS = 4 * MS_NS  # between two checks of the keyboard
ASK = (
    "Point the camera at this screen, or use a mirror, so that the screen is in the middle of its"
    " picture."
)
AGAIN = UserError("nothing was measured", "start again when you are ready")
SMALL_PX, INSET_PX = 64, 240  # widths: of the pictures that are compared, and for the person
# frames without a stamp that a good driver delivers too, at its start and later
MAX_UNSTAMPED, UNSTAMPED_SHARE = 5, 0.1


class CameraWatch(threading.Thread):
    """Reads the camera in its own thread.

    inset: the newest picture, small. failure: why it ended.
    """

    def __init__(self, source: FrameSource, frame_px: tuple[int, int]) -> None:
        super().__init__(daemon=True)
        self._source = source
        self._ended = threading.Event()
        self._frame = np.empty((frame_px[1], frame_px[0], 3), np.uint8)
        # stamp and small picture; appended here, copied elsewhere
        self._frames: list[tuple[int, NDArray[np.uint8]]] = []
        self._unstamped = 0
        self.inset: NDArray[np.uint8] | None = None
        self.failure: UserError | None = None

    def run(self) -> None:
        while not self._ended.is_set():
            try:
                frame = self._source.read(self._frame)
            except (TimeoutError, BrokenFrame):
                continue
            except UserError as error:
                self.failure = error
                return
            if frame is None:
                self.failure = UserError(
                    "the source ended", "use a camera: a recording does not see this screen"
                )
                return
            if frame.stamp in (StampKind.SCHEDULED, StampKind.READ):
                self._unstamped += 1
                continue
            self.inset = self._scaled(INSET_PX)
            grey = np.asarray(cv2.cvtColor(self._scaled(SMALL_PX), cv2.COLOR_BGR2GRAY), np.uint8)
            self._frames.append((frame.t_sensor_ns, grey))

    def _scaled(self, width_px: int) -> NDArray[np.uint8]:
        height, width = self._frame.shape[:2]
        size_px = (width_px, width_px * height // width)
        return np.asarray(cv2.resize(self._frame, size_px, interpolation=cv2.INTER_AREA), np.uint8)

    @property
    def stamped(self) -> bool:
        """Whether the driver stamps the frames: nearly all; single frames without a stamp are left
        out.
        """
        return self._unstamped < max(MAX_UNSTAMPED, len(self._frames) * UNSTAMPED_SHARE)

    def frames(self, since_ns: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """Stamps (n,) and pictures (n, height, width) from since_ns on."""
        frames = [frame for frame in list(self._frames) if frame[0] >= since_ns]
        pictures = (
            np.stack([picture for _, picture in frames])
            if frames
            else np.empty((0, 1, 1), np.uint8)
        )
        return np.array([t_ns for t_ns, _ in frames], np.int64), pictures

    def close(self) -> None:
        self._ended.set()
        self.join()
        self._source.close()


def advice(area: NDArray[np.bool_]) -> str:
    """How to move the camera so that the screen is in the middle of its picture; "" if it is."""
    place = float(np.nonzero(area)[0].mean() + 0.5) / len(area) - 0.5
    return (
        f"Screen too {'high' if place < 0 else 'low'}: aim the camera at its middle."
        if abs(place) > SPAN
        else ""
    )


def measure_device_latency(config: Config, camera: str | None) -> tuple[LoopDelay, Monitor]:
    """Returns the device latency and the monitor on which it was measured. Takes MEASURE_S once
    the camera sees the window.

    Raises UserError without a screen, if `estimate` refuses, if the camera fails, or if the user
    cancels.
    """
    if not has_display():
        raise UserError(
            "--latency needs a screen with a window for the camera to see", "run it on a desktop"
        )
    with closing(
        CameraWatch(
            open_source(camera or config.camera.source, camera_settings(config)),
            config.camera.frame_px,
        )
    ) as watch:
        watch.start()
        flipping = _FlippingWindow(config, watch)
        with closing(flipping.window):
            return flipping.measured(), flipping.window.monitor


class _FlippingWindow:
    """The window that flips. Odd pictures are white."""

    def __init__(self, config: Config, watch: CameraWatch) -> None:
        from lfpipe.render.display.window import ScreenWindow

        self._camera = config.camera
        self._watch = watch
        self.window = ScreenWindow(
            WINDOW_PX, "lfpipe calibrate", monitor=str(config.screen.monitor)
        )
        self._levels = [np.full((9, 16, 3), 255 * white, np.uint8) for white in (0, 1)]
        hz = self.window.monitor.rate_hz
        self._clock = ScreenClock(hz, now_ns())
        self._rng = np.random.default_rng(1)
        self._step = max(1, round(hz / 60.0))
        self._number = 0
        self._due_ns = now_ns()
        self._presented_ns: dict[int, int] = {}

    def measured(self) -> LoopDelay:
        """Waits until the camera sees the window, then measures.

        Pictures have the sensor's order of rows.
        """
        since_ns = self._aimed_ns()
        self._say(f"Screen detected. Measuring for {MEASURE_S:.0f} s. Keep still.", None)
        while self._flip() < since_ns + MEASURE_S * SECOND_NS:
            pass
        recording = self._recording(since_ns)
        return estimate(attrs.evolve(recording, pictures=as_read(recording.pictures, self._camera)))

    def _aimed_ns(self) -> int:
        """Flips until the camera sees the window in the middle of its picture; returns since when.
        After AIM_S, and for a camera without stamps, the estimate reports the problem.
        """
        began_ns = look_ns = now_ns()
        while (t_ns := self._flip()) < began_ns + AIM_S * SECOND_NS and self._watch.stamped:
            since_ns = t_ns - int(LOOK_S * SECOND_NS)
            if t_ns > look_ns and since_ns > began_ns:
                look_ns = t_ns + int(LOOK_EVERY_S * SECOND_NS)
                if not (state := self._advice(since_ns)):
                    return since_ns
                self._say(state, self._watch.inset)
        return t_ns - int(MEASURE_S * SECOND_NS)

    def _flip(self) -> int:
        """Shows the other level at the end of its hold; returns the submission time."""
        if self._watch.failure is not None:
            raise self._watch.failure
        window = self.window
        clock = self._clock
        reported = bool(window.vblank_source)
        hold_ns = int(self._rng.integers(HOLDS[0], HOLDS[1] + 1)) * self._step * clock.period_ns
        lead_ns = round(clock.period_ns / 2) * reported
        # after a late flip no hold is cut short
        self._due_ns = max(self._due_ns, now_ns() + lead_ns) + round(hold_ns)
        if reported:
            self._due_ns = clock.nearest(self._due_ns)
        begin_ns = self._due_ns - lead_ns
        while now_ns() < begin_ns:
            if {"quit", "close"} & {event.name for event in window.events()}:
                raise AGAIN
            sleep_until(min(begin_ns, now_ns() + EVENTS_NS))
        t_ns = now_ns()
        self._number += 1
        window.show(self._levels[self._number % 2])
        if not reported:
            # as a session plans it if no vblanks are reported
            self._presented_ns[self._number] = t_ns
        for answer in window.presented():
            if answer.t_ns:
                clock.vblank(answer.t_ns, answer.period_ns)
                self._presented_ns.setdefault(answer.serial, answer.t_ns)
        return t_ns

    def _recording(self, since_ns: int) -> Recording:
        """The recording from since_ns on."""
        t_frame_ns, pictures = self._watch.frames(since_ns)
        flips = sorted(
            (t_ns, number) for number, t_ns in self._presented_ns.items() if t_ns >= since_ns
        )
        times, numbers = np.array(flips, np.int64).reshape(-1, 2).T
        return Recording(
            t_flip_ns=times,
            bright=numbers % 2 == 1,
            t_frame_ns=t_frame_ns,
            pictures=pictures,
            stamped=self._watch.stamped,
            refresh_ms=self._clock.period_ns / 1e6,
        )

    def _advice(self, since_ns: int) -> str:
        """How to move the camera; "" if it sees the window in the middle of its picture."""
        recording = self._recording(since_ns)
        if len(recording.t_frame_ns) < MIN_FRAMES / 2 or len(recording.t_flip_ns) < MIN_FRAMES / 4:
            return ASK
        r = find_area(recording)[0]
        area = r > max(CLEAR_R, AREA_R * r.max())
        return advice(area) if area.sum() >= MIN_PIXELS else ASK

    def _say(self, state: str, inset: NDArray[np.uint8] | None) -> None:
        self.window.overlay(Overlay(lines=(state, "f full screen, q ends"), inset=inset))
