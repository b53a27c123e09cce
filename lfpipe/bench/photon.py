"""Subject: motion to photon on a known motion, by the definitions of docs/photon.md.

Onset latency: from the moment at which a resting head has moved by ONSET_PX to the light of the first picture made for moved
eyes. Nothing can be predicted yet, so it covers the whole path from exposure to light, including the wait for frame and refresh.
Steady latency: the time shift that explains most of the displayed error while the head moves, -sum(error * velocity) /
sum(velocity^2): positive if pictures lag, 0 if prediction compensates fully.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache, partial

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.filters import FOCAL_PX, HOME_MM, NOISE_PX, known_motion
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.model import Candidate, Diagram, Figure, Prepared, Profile, Samples, Subject
from lfpipe.bench.motion import viewer_path
from lfpipe.config import Track
from lfpipe.track.filters import make_filter
from lfpipe.track.smoothing import EyeFilter, Mean

HORIZONS_MS = (20, 40, 60, 80, 100, 120, 140)
SHOWN_MS, LOOP_MS = 80, 60  # of the diagram; of camera and display, if unknown
CAMERA_HZ, REFRESH_HZ = 30, 60
ONSET_PX = 3.0  # mean of both eyes: far above noise, yet the head has hardly moved
UNDER_WAY_PX_S = 60.0
WITHIN_MS = 600  # a later onset counts as not followed at all

Float = NDArray[np.float64]


@attrs.frozen
class Displayed:
    """Pictures by their time of light. at: int (n,), ms of the path. used: float (n, 2, 2), eyes that they were made for, px."""

    at: NDArray[np.int64]
    used: Float


def displayed(filter_: EyeFilter, horizons_ms: tuple[int, ...], unknown_ms: float = 0.0, seed: int = 30) -> list[Displayed]:
    """The pictures that a display of REFRESH_HZ shows of the known motion, for each time from exposure to light.

    unknown_ms: the part of that time unknown to the prediction. Only light while the camera sees the eyes counts.
    """
    eyes, visible, _ = known_motion()
    rng, frame = np.random.default_rng(seed), 0
    made: list[tuple[list[int], list[Float]]] = [([], []) for _ in horizons_ms]
    for refresh in range(int(len(eyes) / 1e3 * REFRESH_HZ)):
        now_ms = refresh * 1e3 / REFRESH_HZ
        while frame * 1e3 / CAMERA_HZ <= now_ms:
            seen = int(frame * 1e3 / CAMERA_HZ)
            if visible[seen]:
                filter_.update(round(frame * 1e9 / CAMERA_HZ), eyes[seen] + rng.normal(0.0, NOISE_PX, (2, 2)))
            frame += 1
        for (at, used), horizon_ms in zip(made, horizons_ms, strict=True):
            light = round(now_ms + horizon_ms)
            if light < len(eyes) and visible[light] and visible[seen]:
                at.append(light)
                used.append(filter_.predict(round((now_ms + max(horizon_ms - unknown_ms, 0)) * 1e6)))
    return [Displayed(np.array(at), np.array(used)) for at, used in made]


def errors_px(pictures: Displayed) -> Float:
    """RMS distance of both eyes from the truth, for each picture."""
    off = pictures.used - known_motion()[0][pictures.at]
    return np.asarray(np.sqrt(np.square(off).sum(axis=(1, 2)) / 2))


def velocity_px_s(at: NDArray[np.int64]) -> Float:
    """True velocity (n, 2, 2) around those ms of the path."""
    eyes = known_motion()[0]
    low, high = np.maximum(at - 5, 0), np.minimum(at + 5, len(eyes) - 1)
    return np.asarray((eyes[high] - eyes[low]) / ((high - low) / 1e3)[:, None, None])


def steady_ms(pictures: Displayed) -> list[float]:
    """Steady latency of each second of the path in which the head moves."""
    velocity = velocity_px_s(pictures.at)
    moving = np.sqrt(np.square(velocity).sum(axis=(1, 2)) / 2) > UNDER_WAY_PX_S
    off = ((pictures.used - known_motion()[0][pictures.at]) * velocity).sum(axis=(1, 2))
    power = np.square(velocity).sum(axis=(1, 2))
    found = []
    for second in np.unique(pictures.at[moving] // 1000):
        part = moving & (pictures.at // 1000 == second)
        found.append(float(-off[part].sum() / power[part].sum() * 1e3))
    return found


@lru_cache(maxsize=1)
def onsets() -> list[tuple[int, int]]:
    """(end of the rest, moment at which the eyes have moved by ONSET_PX), ms, of each motion that begins at rest."""
    eyes, visible, _ = known_motion()
    middle, found, t_ms, before = eyes.mean(axis=1), [], 0.0, ""
    for piece in viewer_path(HOME_MM, 320 * HOME_MM / FOCAL_PX):
        start = int(t_ms)
        if before == "still" and piece.name in ("reach", "stop") and visible[start]:
            away = np.linalg.norm(middle[start:] - middle[start], axis=1) > ONSET_PX
            found.append((start, start + int(away.argmax())))
        before, t_ms = piece.name, t_ms + piece.duration_s * 1e3
    return found


def onset_ms(pictures: Displayed) -> list[float]:
    """Onset latency of each motion that begins at rest."""
    eyes, used = known_motion()[0].mean(axis=1), pictures.used.mean(axis=1)
    late = []
    for start, moved in onsets():
        soon = (pictures.at >= moved) & (pictures.at < moved + WITHIN_MS)
        away = np.linalg.norm(used[soon] - eyes[start], axis=1) > ONSET_PX
        if away.any():
            late.append(float(pictures.at[soon][away.argmax()] - moved))
    return late


def samples(make: Callable[[], EyeFilter], unknown_ms: float) -> Samples:
    """Samples of every figure of the subject."""
    found: Samples = {}
    for horizon_ms, pictures in zip(HORIZONS_MS, displayed(make(), HORIZONS_MS, unknown_ms), strict=True):
        errors = errors_px(pictures)
        seconds = [errors[pictures.at // 1000 == second] for second in np.unique(pictures.at // 1000)]
        found[f"error_{horizon_ms}ms"] = [float(np.sqrt(np.mean(np.square(part)))) for part in seconds]
        found[f"onset_{horizon_ms}ms"] = onset_ms(pictures)
        found[f"steady_{horizon_ms}ms"] = steady_ms(pictures)
    return found


def candidates(inputs: Inputs) -> Iterator[Candidate]:
    """The filters with a known horizon, the default one with LOOP_MS of it unknown, and the paper's average."""
    for name in ("predictive", "kalman", "one-euro"):
        track = Track(filter=name)
        yield Candidate(name, "default", partial(_prepare, partial(make_filter, track), 0.0))
    yield Candidate(f"predictive, {LOOP_MS} ms unknown", "default", partial(_prepare, partial(make_filter, Track()), LOOP_MS))
    yield Candidate("mean", "k = 5", partial(_prepare, partial(Mean, 5), 0.0), True)


def _prepare(make: Callable[[], EyeFilter], unknown_ms: float) -> Prepared:
    return Prepared(partial(samples, make, unknown_ms))


_KNOBS = ("default", "k = 5")

SUBJECT = Subject(
    "photon",
    "Motion to photon",
    "The same known motion, camera at 30 Hz, display at 60 Hz. How much later than the head do its pictures begin to move, and"
    " how far do they lag while it moves, against the time from exposure to light?",
    (
        *(Figure(f"onset_{h}ms", f"latency at onset, light {h} ms after exposure", "ms", "mean") for h in HORIZONS_MS),
        *(Figure(f"steady_{h}ms", f"steady latency, light {h} ms after exposure", "ms") for h in HORIZONS_MS),
        *(Figure(f"error_{h}ms", f"displayed error, RMS, light {h} ms after exposure", "px", "rms") for h in HORIZONS_MS),
    ),
    (
        Diagram("photon", "Displayed error against latency at the onset", f"onset_{SHOWN_MS}ms", f"error_{SHOWN_MS}ms"),
        *(
            Profile(
                f"photon-{key}",
                title,
                "from exposure to light, ms",
                "latency, ms",
                tuple((float(h), f"{key}_{h}ms") for h in HORIZONS_MS),
                _KNOBS,
            )
            for key, title in (("onset", "Latency at the onset of a motion"), ("steady", "Steady latency, head under way"))
        ),
    ),
    candidates,
    paper="mean of k = 5, without prediction",
)
