"""Subject: face engines. Error against the true eyes of a sequence, lag, time per camera frame."""

import itertools
import time
from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.eye_path import EyePath
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Candidate, Chart, Choice, Figure, Prepared, Samples, Skipped, Subject
from lfpipe.bench.stats import time_figures, times_ms
from lfpipe.config import Track
from lfpipe.track.engine import Engine, make_engine
from lfpipe.track.models import package_folder

ENGINES = ("litert", "mediapipe")
WIDTHS_PX, EVERY = (640, 320, 160), (1, 2, 3)  # of the input; of every n-th frame
QUICK = ((640, 1), (320, 1), (640, 2))
TURN_FRAMES = 12
LAGS_MS = np.arange(-40.0, 201.0, 1.0)

Float = NDArray[np.float64]


def track_frames(engine: Engine, frames: NDArray[np.uint8], every: int, scale: float) -> Float:
    """Eyes (n, 2, 2) in px of the frames times scale, from every `every`-th frame, held in between; NaN if no face is found."""
    found = np.full((len(frames), 2, 2), np.nan)
    for k, frame in enumerate(frames):
        if k % every:
            found[k] = found[k - 1]
        else:
            face = engine.detect(frame)
            found[k] = np.nan if face is None else face.eyes_px * scale
    return found


def motion_errors(found: Float, truth: Float) -> Samples:
    """Figures of measured eyes (n, 2, 2) against the true ones, over frames with a face.

    Engines define the centre of an eye differently (lids or iris). The median offset from the truth, in distances between the
    eyes, is therefore subtracted and reported as `offset`.
    """
    seen = np.isfinite(found).all(axis=(1, 2))
    between_px = np.linalg.norm(truth[seen, 0] - truth[seen, 1], axis=1)
    error = (found[seen] - truth[seen]) / between_px[:, None, None]
    offset = np.median(error, axis=0)
    worst = np.linalg.norm(error - offset, axis=2).max(axis=1)
    return {
        "error_px": (worst * between_px).tolist(),
        "error_share": worst.tolist(),
        "offset": [float(np.linalg.norm(offset, axis=1).max())],
        "missed": np.where(seen, 0.0, 1.0).tolist(),
    }


def lag_ms(found: Float, truth: EyePath, t_ns: NDArray[np.int64]) -> float:
    """Delay of the measured eyes: the shift of the truth that fits them best; NaN if nothing moves."""
    seen = np.isfinite(found).all(axis=(1, 2))
    if float(truth.eyes_px.std(axis=0).max()) < 1.0:
        return float("nan")
    found, t_ns = found[seen], t_ns[seen]
    errors = (found - truth.at(t_ns - lag * 1e6) for lag in LAGS_MS)
    return float(LAGS_MS[int(np.argmin([np.square(error - error.mean(axis=0)).mean() for error in errors]))])


def candidates(inputs: Inputs) -> Iterator[Candidate | Skipped]:
    """Engines x refine x input size x every n-th frame."""
    truth = inputs.sequence.truth
    if truth is None:
        yield Skipped("error of tracking", f"{inputs.sequence.path.name} has no truth; only times are measured")
    height_px, width_px = inputs.sequence.frames.shape[1:3]
    offered = QUICK if inputs.quick else tuple((width, every) for every in EVERY for width in WIDTHS_PX)
    knobs = [knob for knob in offered if knob[0] <= width_px] or [(width_px, 1)]
    if len(knobs) < len(offered):
        yield Skipped(f"input wider than {width_px} px", "the frames of the sequence are smaller")
    engines = [name for name in ENGINES if name != "mediapipe" or package_folder()]
    if len(engines) < len(ENGINES):
        yield Skipped("engine mediapipe", "the package is not installed here")
    for name in engines:
        for refine in (False, True):
            for width, every in knobs:
                size = (width, round(height_px * width / width_px))
                knob = f"{size[0]}x{size[1]}" + (f", one frame in {every}" if every > 1 else "")
                paper = name == "mediapipe" and not refine and (width, every) == knobs[0]
                curve = name + (" with irises" if refine else "")
                track = Track(engine="mediapipe" if name == "mediapipe" else "litert", refine=refine)
                used = track == Track() and (width, every) == knobs[0]
                yield Candidate(curve, knob, partial(_prepare, inputs, track, size, every), paper, used, f"one in {every}")


def _prepare(inputs: Inputs, track: Track, size: tuple[int, int], every: int) -> Prepared:
    sequence, truth = inputs.sequence, inputs.sequence.truth
    frames = sequence.frames
    scale = frames.shape[2] / size[0]
    if size != (frames.shape[2], frames.shape[1]):
        frames = np.stack([cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames])
    engine = make_engine(track)
    t_ns = np.round(np.arange(len(frames)) * 1e9 / sequence.rate_hz).astype(np.int64)

    def errors() -> Samples:
        engine.reset()
        found = track_frames(engine, frames, every, scale)
        if not np.isfinite(found).any():
            raise ValueError("no face found in any frame")
        if truth is None:
            return {"missed": np.where(np.isfinite(found).all(axis=(1, 2)), 0.0, 1.0).tolist()}
        lag = lag_ms(found, truth, t_ns)
        return motion_errors(found, truth.eyes_px[: len(found)]) | ({"lag_ms": [lag]} if np.isfinite(lag) else {})

    upcoming = itertools.cycle(frames[::every])

    def turn() -> dict[str, float]:
        cpu_ns = time.process_time_ns()
        times = times_ms(lambda: engine.detect(next(upcoming)), TURN_FRAMES)
        cpu_ms = (time.process_time_ns() - cpu_ns) / 1e6 / TURN_FRAMES / every
        return time_figures(times, scale=1 / every) | {"cpu_ms": cpu_ms}

    return Prepared(errors, turn, engine.close)


SUBJECT = Subject(
    "tracker",
    "Tracking the eyes",
    "How closely does each engine follow the eyes of the sequence, and what does a camera frame cost? If an engine sees only"
    " every n-th frame, its eyes are held between and its time is divided by n.",
    (
        Figure("error_px", "error of the worse eye, RMS", "px of the frame", "rms"),
        Figure("error_share", "error of the worse eye, RMS", "of the distance between the eyes", "rms"),
        Figure("offset", "offset of the eye centre", "of the distance between the eyes"),
        Figure("missed", "frames without a face", "share", "mean"),
        Figure("lag_ms", "lag", "ms"),
        Figure("time_ms", "time per camera frame, p50", "ms"),
        Figure("time_p95_ms", "time per camera frame, p95", "ms"),
        Figure("cpu_ms", "CPU per camera frame, all threads", "ms"),
    ),
    (
        Chart("tracker", "Error of tracking against time", "time_ms", "error_px"),
        Chart("tracker-share", "Error of tracking, in distances between the eyes, against CPU", "cpu_ms", "error_share"),
    ),
    candidates,
    paper="FaceMesh (engine mediapipe) on every frame of 640x480",
    needs=("sequence",),
    choice=Choice("track.engine", "time_ms", "error_px", 11.0, "a third of a frame at 30 Hz"),
    budget_s=(6.0, 60.0),
)
