"""Subject: motion to photon on a known motion, by the definitions of docs/photon.md.

Onset latency: from the moment at which a resting head has moved by ONSET_PX to the light of the first picture made for moved
eyes. Nothing can be predicted yet, so it covers the whole path from exposure to light, including the wait for frame and refresh.
Steady latency: the time shift that explains most of the displayed error while the head moves, -sum(error * velocity) /
sum(velocity^2): positive if pictures lag, 0 if prediction compensates fully.
"""

import itertools
from collections.abc import Callable, Iterator
from functools import lru_cache, partial

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.motion import ONSET_PX, HeadMotion, known_motion, minimum_jerk
from lfpipe.bench.results import Figures, State, Table, judged_table, rms
from lfpipe.bench.runner import Candidate, Offer
from lfpipe.bench.subjects import LIGHT_MS, NOISE_PX, SHOWN_MS
from lfpipe.config import Track
from lfpipe.track.filters import make_filter
from lfpipe.track.smoothing import EyeFilter, Mean

LOOP_MS = 60  # of camera and display, if unknown
CAMERA_HZ, REFRESH_HZ = 30, 60  # of usual webcams and monitors
UNDER_WAY_PX_S = 60.0  # an eye distance per second: slower, noise outweighs the motion
NOISES_PX = (0.15, NOISE_PX, 0.5)  # a good camera, live faces, little light
ONSET_MS = 300  # of a motion, not steady
WITHIN_MS = 600  # a later onset counts as not followed at all
MOTIONS = (
    "step to 100 px/s",
    "step to 200 px/s",
    "reach of 80 px in 0.8 s",
    "sine of 0.5 Hz, 60 px",
)

Float = NDArray[np.float64]


@attrs.frozen(eq=False)
class Displayed:
    """Pictures by their time of light. at: int (n,), ms of the motion. used: (n, 2, 2), eyes that they were made for, px."""

    at: NDArray[np.int64]
    used: Float
    motion: HeadMotion


@lru_cache(maxsize=8)
def simple_motion(name: str) -> HeadMotion:
    """One of MOTIONS, five times, there and back, each after a rest of 2 s (a sine: 20 s of it)."""
    t_s = np.arange(20_000) / 1e3
    s = np.clip((t_s % 4.0 - 2.0) / 0.8, 0, 1)  # since the start of the motion; negative: at rest
    if name.startswith("sine"):
        x_px = 60 * np.sin(np.pi * t_s)
    else:
        way_px, share = (
            (float(name.split()[2]) * 0.8, s)
            if name.startswith("step")
            else (80.0, minimum_jerk(s))
        )
        x_px = way_px * np.where(t_s % 8 < 4, share, 1 - share)
    eyes = (
        np.array([[[350.0, 240.0], [290.0, 240.0]]])
        + np.stack([x_px, 0 * x_px], axis=1)[:, None, :]
    )
    rests_ms = () if name.startswith("sine") else range(2000, 20_000, 4000)
    return HeadMotion.of(eyes, np.ones(len(eyes), bool), np.zeros(len(eyes), bool), rests_ms)


def displayed(
    filter_: EyeFilter, horizons_ms: tuple[int, ...], unknown_ms: float = 0.0, noise_px: float = NOISE_PX,
    motion: HeadMotion | None = None,
) -> list[Displayed]:  # fmt: skip
    """The pictures that a display of REFRESH_HZ shows of a motion, by default the whole path, for each time from exposure to
    light. unknown_ms: the part of that time unknown to the prediction. Only light while the camera sees the eyes counts.
    """
    motion = motion or known_motion()
    eyes, visible = motion.eyes, motion.visible
    rng, frame = np.random.default_rng(30), 0
    pictures: list[tuple[list[int], list[Float]]] = [([], []) for _ in horizons_ms]
    for refresh in range(int(len(eyes) / 1e3 * REFRESH_HZ)):
        now_ms = refresh * 1e3 / REFRESH_HZ
        while frame * 1e3 / CAMERA_HZ <= now_ms:
            seen = int(frame * 1e3 / CAMERA_HZ)
            if visible[seen]:
                filter_.update(
                    round(frame * 1e9 / CAMERA_HZ), eyes[seen] + rng.normal(0.0, noise_px, (2, 2))
                )
            frame += 1
        for (at, used), horizon_ms in zip(pictures, horizons_ms, strict=True):
            light = round(now_ms + horizon_ms)
            if light < len(eyes) and visible[light] and visible[seen]:
                at.append(light)
                used.append(
                    filter_.predict(round((now_ms + max(horizon_ms - unknown_ms, 0)) * 1e6))
                )
    return [Displayed(np.array(at), np.array(used), motion) for at, used in pictures]


def steady_ms(pictures: Displayed) -> list[float]:
    """Steady latency of each second in which the head moves; the first 0.3 s of a motion from rest are its onset."""
    eyes, at = pictures.motion.eyes, pictures.at
    low, high = (
        np.maximum(at - 5, 0),
        np.minimum(at + 5, len(eyes) - 1),
    )  # around the time of each picture
    velocity = (eyes[high] - eyes[low]) / ((high - low) / 1e3)[:, None, None]
    power = np.square(velocity).sum(axis=(1, 2))
    moving = np.sqrt(power / 2) > UNDER_WAY_PX_S
    for start, _ in pictures.motion.starts:
        moving &= (at < start) | (at >= start + ONSET_MS)
    off = ((pictures.used - eyes[at]) * velocity).sum(axis=(1, 2))
    within = [moving & (at // 1000 == second) for second in np.unique(at[moving] // 1000)]
    return [float(-off[now].sum() / power[now].sum() * 1e3) for now in within]


def onset_ms(pictures: Displayed) -> list[float]:
    """Onset latency of each motion that begins at rest."""
    eyes, used = pictures.motion.eyes.mean(axis=1), pictures.used.mean(axis=1)
    late = []
    for start, moved in pictures.motion.starts:
        soon = (pictures.at >= moved) & (pictures.at < moved + WITHIN_MS)
        away = np.linalg.norm(used[soon] - eyes[start], axis=1) > ONSET_PX
        if away.any():
            late.append(float(pictures.at[soon][away.argmax()] - moved))
    return late


def _prepare(make: Callable[[], EyeFilter], unknown_ms: float) -> tuple[Figures, None]:
    figures: Figures = {}
    for horizon_ms, pictures in zip(LIGHT_MS, displayed(make(), LIGHT_MS, unknown_ms), strict=True):
        squares = (
            np.square(pictures.used - pictures.motion.eyes[pictures.at]).sum(axis=(1, 2)) / 2
        )  # of both eyes
        seconds = [
            squares[pictures.at // 1000 == second] for second in np.unique(pictures.at // 1000)
        ]
        figures[f"error_{horizon_ms}ms"] = rms([np.sqrt(np.mean(second)) for second in seconds])
        figures[f"onset_{horizon_ms}ms"] = float(np.mean(onset_ms(pictures)))
        figures[f"steady_{horizon_ms}ms"] = float(np.median(steady_ms(pictures)))
    return figures, None


def motion_table() -> Table:
    """Onset and steady latency of single motions, by the noise of the landmarks."""
    note = (
        f"Onset / steady latency in ms, light {SHOWN_MS} ms after exposure, camera at {CAMERA_HZ} Hz, display at {REFRESH_HZ} Hz,"
        " by the noise of the landmarks; live faces have 0.22 to 0.34 px. Steady: from 0.3 s after the start of the motion."
    )
    rows = {
        f"{name}, {noise_px:g} px": (name, noise_px)
        for name, noise_px in itertools.product(MOTIONS, NOISES_PX)
    }
    filters: dict[str, Callable[[], EyeFilter]] = {
        f"{Track().filter} (in use)": partial(make_filter, Track())
    }
    filters["mean of 5, the paper"] = partial(Mean, 5)

    def latencies(row: tuple[str, float], make: Callable[[], EyeFilter]) -> tuple[str, State]:
        name, noise_px = row
        (pictures,) = displayed(make(), (SHOWN_MS,), noise_px=noise_px, motion=simple_motion(name))
        onset, steady = onset_ms(pictures), round(float(np.median(steady_ms(pictures))))
        return (f"{np.mean(onset):.0f} / " if onset else "- / ") + f"{steady}", ""

    return judged_table("Latency by motion and noise", note, "motion", rows, filters, latencies)


def measure(inputs: Inputs) -> Iterator[Offer]:
    """The filters with a known horizon, the default one with LOOP_MS of it unknown, and the paper's average."""
    for name in ("predictive", "kalman", "one-euro"):
        track = Track(filter=name)
        yield Candidate(
            name,
            "default",
            partial(_prepare, partial(make_filter, track), 0.0),
            used=track == Track(),
        )
    yield Candidate(
        f"predictive, {LOOP_MS} ms unknown",
        "default",
        partial(_prepare, partial(make_filter, Track()), LOOP_MS),
    )
    yield Candidate("mean", "k = 5", partial(_prepare, partial(Mean, 5), 0.0), True)
    yield motion_table()
