"""Subject: face engines. Error against the true eyes of a sequence, lag, time per camera frame."""

import itertools
import time
from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs, eyes_at
from lfpipe.bench.runner import Candidate, Found, Samples, Turn, time_figures, times_ms
from lfpipe.config import Track
from lfpipe.sequence.eyes import Truth
from lfpipe.track.engine import Engine, make_engine
from lfpipe.track.models import package_folder

ENGINES = ("litert", "mediapipe")
KNOBS = ((640, 1), (320, 1), (640, 2)), ((640, 1), (320, 1), (160, 1), (640, 2), (640, 3))  # width, every n-th; quick and full
TURN_FRAMES = 12
LAGS_MS = np.arange(-40.0, 201.0, 1.0)

Float = NDArray[np.float64]


def track_frames(engine: Engine, frames: NDArray[np.uint8], every: int, scale: float) -> Float:
    """Eyes (n, 2, 2) in px of the frames times scale, from every `every`-th frame, held in between; NaN if no face is found."""
    eyes = np.full((len(frames), 2, 2), np.nan)
    for k, frame in enumerate(frames):
        if k % every:
            eyes[k] = eyes[k - 1]
        elif (face := engine.detect(frame)) is not None:
            eyes[k] = face.eyes_px * scale
    return eyes


def motion_errors(eyes: Float, truth: Float) -> Samples:
    """Figures of measured eyes (n, 2, 2) against the true ones, over frames with a face.

    Engines define the centre of an eye differently (lids or iris). The median offset from the truth, in distances between the
    eyes, is therefore subtracted and reported as `offset`.
    """
    seen = np.isfinite(eyes).all(axis=(1, 2))
    between_px = np.linalg.norm(truth[seen, 0] - truth[seen, 1], axis=1)
    error = (eyes[seen] - truth[seen]) / between_px[:, None, None]
    offset = np.median(error, axis=0)
    worst = np.linalg.norm(error - offset, axis=2).max(axis=1)
    return {
        "error_px": (worst * between_px).tolist(),
        "error_share": worst.tolist(),
        "offset": [float(np.linalg.norm(offset, axis=1).max())],
        "missed": np.where(seen, 0.0, 1.0).tolist(),
    }


def lag_ms(eyes: Float, truth: Truth, t_ns: NDArray[np.int64]) -> float:
    """Delay of the measured eyes: the shift of the truth that fits them best; NaN if nothing moves."""
    seen = np.isfinite(eyes).all(axis=(1, 2))
    if float(truth.eyes_px.std(axis=0).max()) < 1.0:
        return float("nan")
    errors = (eyes[seen] - eyes_at(truth, t_ns[seen] - lag * 1e6) for lag in LAGS_MS)
    return float(LAGS_MS[int(np.argmin([np.square(error - error.mean(axis=0)).mean() for error in errors]))])


def measure(inputs: Inputs) -> Iterator[Found]:
    """Engines x refine x (input size, every n-th frame)."""
    if inputs.sequence.truth is None:
        yield f"error of tracking: {inputs.sequence.path.name} has no truth; only times are measured"
    height_px, width_px = inputs.sequence.frames.shape[1:3]
    offered = KNOBS[0 if inputs.quick else 1]
    knobs = [knob for knob in offered if knob[0] <= width_px] or [(width_px, 1)]
    if len(knobs) < len(offered):
        yield f"input wider than {width_px} px: the frames of the sequence are smaller"
    engines = [name for name in ENGINES if name != "mediapipe" or package_folder()]
    if len(engines) < len(ENGINES):
        yield "engine mediapipe: the package is not installed here"
    for name, refine, (width, every) in itertools.product(engines, (False, True), knobs):
        size = (width, round(height_px * width / width_px))
        knob = f"{size[0]}x{size[1]}" + (f", one frame in {every}" if every > 1 else "")
        track = Track(engine="mediapipe" if name == "mediapipe" else "litert", refine=refine)
        paper, used = (track == one and (width, every) == knobs[0] for one in (Track(engine="mediapipe"), Track()))
        yield Candidate(name + " with irises" * refine, knob, partial(_prepare, inputs, track, size, every), paper, used)


def _prepare(inputs: Inputs, track: Track, size: tuple[int, int], every: int) -> tuple[Samples, Turn]:
    sequence, truth = inputs.sequence, inputs.sequence.truth
    frames = sequence.frames
    scale = frames.shape[2] / size[0]
    if size != (frames.shape[2], frames.shape[1]):
        frames = np.stack([cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames])
    engine = make_engine(track)
    eyes = track_frames(engine, frames, every, scale)
    seen = np.isfinite(eyes).all(axis=(1, 2))
    if not seen.any():
        raise ValueError("no face found in any frame")
    samples = {"missed": np.where(seen, 0.0, 1.0).tolist()}
    if truth is not None:
        samples = motion_errors(eyes, truth.eyes_px[: len(eyes)])
        lag = lag_ms(eyes, truth, np.round(np.arange(len(frames)) * 1e9 / sequence.rate_hz).astype(np.int64))
        samples |= {"lag_ms": [lag]} if np.isfinite(lag) else {}
    upcoming = itertools.cycle(frames[::every])

    def turn() -> dict[str, float]:
        cpu_ns = time.process_time_ns()
        times = times_ms(lambda: engine.detect(next(upcoming)), TURN_FRAMES)
        cpu_ms = (time.process_time_ns() - cpu_ns) / 1e6 / TURN_FRAMES / every
        return time_figures(times, scale=1 / every) | {"cpu_ms": cpu_ms}

    return samples, turn
