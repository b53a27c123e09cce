"""The simulated camera: times and stamps of its frames, and the landmarks in them."""

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.simulator.scripts import Script
from lfpipe.capture.camera import SensorClock
from lfpipe.capture.recordings import FRAME_PX
from lfpipe.track.engine import Engine, Face
from lfpipe.track.litert_engine import LitertEngine
from lfpipe.track.network import Box, Detection, Roi, overlap
from lfpipe.transport.ring import MS_NS, StampKind

NOISE_PX = 0.3  # of live faces at 640x480, whose eyes are 60 px apart: 0.22 to 0.34 px measured
READ_MS = 5.0  # from a frame's exposure until it is read
TRACKED_MS = 10.0  # from a frame's exposure to its eyes, with the read and the networks between
T0_NS = 10**12  # when the simulation begins
# Initial error of a face at the border of the picture, in eye distances: the detector's region is
# cut off, that of its landmarks is not.
CUT_OFF = 0.27
DOUBT = 26.0  # logits of confidence lost per share of a face that the picture cuts off
TURNED = 20.0  # logits of confidence lost in a region rotated by quarter turns
IMAGE = np.broadcast_to(np.uint8(0), (FRAME_PX[1], FRAME_PX[0], 3))


@attrs.frozen(kw_only=True)
class Camera:
    """A camera and its faults."""

    rate_hz: float = 30.0
    jitter_ms: float = 0.0
    """Standard deviation of the exposure time from its even grid."""
    dropped: float = 0.0
    """Share of frames that are lost."""
    doubled: float = 0.0
    """Share of frames that repeat the previous one, with a stamp of their own."""
    every: tuple[int, ...] = (1,)
    """In equal parts of the time, the camera takes only every n-th frame."""
    stamp_noise_ms: float = 0.0
    stamp_late_ms: float = 0.0
    """Lateness of every stamp after the exposure; negative: earlier."""
    wrong_stamp_ms: float = 0.0
    """Error of one stamp every 2 s."""
    noise_px: float = NOISE_PX
    phase: float = 0.0
    """From a vblank of the screen to the first exposure, as a share of the frame interval."""

    def frames(self, seconds: float) -> list["Frame"]:
        """The frames of this many seconds, in order of arrival."""
        rng = np.random.default_rng(round(self.rate_hz))
        frames = []
        taken_ms = 0.0
        clock = SensorClock(self.rate_hz)
        count = int(seconds * self.rate_hz)
        for k in range(count):
            jitter_ms, noise_ms = rng.normal(0.0, 1.0, 2) * (self.jitter_ms, self.stamp_noise_ms)
            drop, double = rng.random(2) < (self.dropped, self.doubled)
            here_ms = max((k + self.phase) * 1e3 / self.rate_hz + jitter_ms, 0.0)
            if not double:
                taken_ms = here_ms
            if k and (drop or k % self.every[k * len(self.every) // count]):
                continue
            late_ms = self.stamp_late_ms + noise_ms
            if k % round(2 * self.rate_hz) == round(self.rate_hz):
                late_ms += self.wrong_stamp_ms
            stamp_ns, _ = clock.middle_ns(
                T0_NS + round((here_ms + late_ms) * MS_NS),
                StampKind.START_OF_EXPOSURE,
                T0_NS + round((here_ms + READ_MS) * MS_NS),
                exposure_ns=0,
            )
            frames.append(
                Frame(
                    seq=k,
                    ms=taken_ms,
                    stamp_ns=stamp_ns,
                    tracked_ns=T0_NS + round((here_ms + TRACKED_MS) * MS_NS),
                )
            )
        return frames


@attrs.frozen(kw_only=True)
class Frame:
    """A frame."""

    seq: int
    ms: float
    """Time of its content."""
    stamp_ns: int
    tracked_ns: int
    """When its eyes are available."""


class Observer(ABC):
    """The people in front of the simulated camera, and the face engine that tracks them."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine

    @abstractmethod
    def picture(self, frame: Frame) -> NDArray[np.uint8]:
        """The camera picture, uint8 (480, 640, 3) BGR."""

    def look(self, frame: Frame) -> tuple[Face | None, NDArray[np.uint8]]:
        """The face that the engine follows in a frame, and the picture."""
        picture = self.picture(frame)
        face = self.engine.detect(picture)
        self.engine.examine(picture)
        return face, picture


class Seen(NamedTuple):
    """A face in a frame."""

    face: Face
    cut_off: bool
    """Whether the border of the picture hides a part of it."""


class SyntheticNetworks:
    """Synthetic networks of a face engine that return the people of a script, with noise."""

    model = "synthetic"

    def __init__(self, script: Script, camera: Camera) -> None:
        self._script = script
        frames = int(script.count_ms / 1e3 * camera.rate_hz) + 1
        size = frames, len(script.people), 2, 2
        self._noise = np.random.default_rng(30).normal(0.0, camera.noise_px, size)
        self._own: Roi | None = None  # the region from the last landmarks
        self.visible: list[Seen] = []
        """All faces of the current frame."""

    def seen(self, frame: Frame) -> list[Seen]:
        """All faces of a frame."""
        ms = round(frame.ms)
        seen = []
        for k, person in enumerate(self._script.people):
            eyes = person.eyes_px(ms)
            eye_distance = math.dist(*eyes.tolist())
            x, y = eyes.mean(axis=0).tolist()
            box = (
                x - 1.2 * eye_distance,
                y - eye_distance,
                x + 1.2 * eye_distance,
                y + 1.6 * eye_distance,
            )
            share = _share_inside(box)
            logit = float(person.logit[min(ms, len(person.logit) - 1)]) - DOUBT * (1 - share)
            if logit <= 0 or not 0 <= x < FRAME_PX[0]:
                continue
            eyes += self._noise[frame.seq, k] * (0.01 if person.still else 1.0) * eye_distance / 60
            if k == 0:
                eyes[:, 0] += eye_distance * self._script.wrong(frame.ms)
            seen.append(Seen(Face(eyes, 1 / (1 + math.exp(-logit)), box, eye_distance), share < 1))
        return seen

    def detect(self, image: object, region: Roi | None = None) -> list[Detection]:
        """Every face in a whole picture; none in a region."""
        return [
            Detection(one.face.box_px, np.concatenate([one.face.eyes_px[::-1]] * 3), 0.9)
            for one in (self.visible if region is None else ())
        ]

    def measure(self, image: object, roi: Roi, min_confidence: float) -> tuple[Face, Roi] | None:
        half = roi.side_px / 2
        square = (roi.x_px - half, roi.y_px - half, roi.x_px + half, roi.y_px + half)
        here = [one for one in self.visible if overlap(one.face.box_px, square) > 0.1]
        if not here or _is_turned(roi):
            return None
        face, cut_off = max(here, key=lambda one: overlap(one.face.box_px, square))
        if face.confidence < min_confidence:
            return None
        if cut_off and roi is not self._own:
            wrong = np.array((0.0, CUT_OFF * face.eye_distance_px))
            face = attrs.evolve(face, eyes_px=face.eyes_px + wrong)
        x0, y0, x1, y1 = face.box_px
        self._own = Roi((x0 + x1) / 2, (y0 + y1) / 2, 1.5 * (y1 - y0), 0.0)
        return face, self._own

    detect_far = detect

    def logit(self, image: object, roi: Roi) -> float:
        return -TURNED if _is_turned(roi) else 0.0


class SyntheticPeople(Observer):
    """The people of a script in front of the engine in use, with synthetic networks."""

    def __init__(self, script: Script, camera: Camera) -> None:
        self.networks = SyntheticNetworks(script, camera)
        super().__init__(LitertEngine(self.networks))

    def picture(self, frame: Frame) -> NDArray[np.uint8]:
        """An empty picture: the networks return the faces of the script."""
        self.networks.visible = self.networks.seen(frame)
        return IMAGE


def _is_turned(roi: Roi) -> bool:
    return abs(roi.angle) > math.pi / 4


def _share_inside(box: Box) -> float:
    """The share of a box inside the picture."""
    left, top, right, bottom = np.clip(box, 0, FRAME_PX * 2).tolist()
    x0, y0, x1, y1 = box
    return float((right - left) * (bottom - top) / ((x1 - x0) * (y1 - y0)))
