"""Benchmark: face engines. Error against the true eyes of a sequence, time per camera frame."""

import itertools
import time
from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import FrameSequence, Inputs, Picture
from lfpipe.bench.results import Value, mean_of, rms
from lfpipe.bench.runner import Offer, Prepared, Variant, cpu_ms
from lfpipe.config import Track, choices
from lfpipe.track.engine import make_engine
from lfpipe.track.models import has_face_mesh

WIDTHS_PX = (640, 320), (640, 320, 160)  # quick and full
REPETITION_FRAMES = 12  # of each repetition
BLOCKS = 10  # parts of a sequence, for the interval of its error: successive frames are similar


def motion_errors(eyes: NDArray[np.float64], truth: NDArray[np.float64]) -> dict[str, Value]:
    """Errors of measured eyes (n, 2, 2) against the true ones, over frames with a face.

    Engines define the centre of an eye differently (lids or iris). The median offset from the
    truth, in eye distances, is therefore subtracted and reported as `offset`.
    """
    valid = np.isfinite(eyes).all(axis=(1, 2))
    between_px = np.linalg.norm(truth[valid, 0] - truth[valid, 1], axis=1)
    error = (eyes[valid] - truth[valid]) / between_px[:, None, None]
    offset = np.median(error, axis=0)
    worst = np.linalg.norm(error - offset, axis=2).max(axis=1)
    blocks = np.array_split(worst, min(BLOCKS, len(worst)))
    return {
        "error": mean_of([100 * rms(block) for block in blocks], power=2),
        "offset": Value(float(np.linalg.norm(offset, axis=1).max())),
    }


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Yields engines x input size."""
    if inputs.sequence.truth is None:
        yield (
            f"tracking error: {inputs.sequence.path.name} has no ground truth; only times are"
            " measured"
        )
    width_px, height_px = inputs.sequence.size_px
    offered = WIDTHS_PX[0 if inputs.quick else 1]
    widths = [width for width in offered if width <= width_px] or [width_px]
    if len(widths) < len(offered):
        yield f"input wider than {width_px} px: the frames of the sequence are smaller"
    engines = list(choices("track.engine"))
    if not has_face_mesh():
        engines.remove("mediapipe")
        yield "engine mediapipe: no FaceMesh is installed"
    for name, width in itertools.product(engines, widths):
        size = (width, round(height_px * width / width_px))
        track = Track(engine=name)  # type: ignore[arg-type]
        yield Variant(
            curve=name,
            parameter=f"{size[0]}x{size[1]}",
            prepare=partial(_prepare, inputs.sequence, track, size),
            paper=track == Track(engine="mediapipe") and width == widths[0],
            used=track == Track() and width == widths[0],
        )


def _prepare(sequence: FrameSequence, track: Track, size: tuple[int, int]) -> Prepared:
    engine = make_engine(track)
    scale = sequence.size_px[0] / size[0]

    def frames() -> Iterator[Picture]:
        for frame in sequence.frames():
            yield np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), np.uint8)

    faces = [engine.detect(frame) for frame in frames()]
    if not any(faces):
        raise ValueError("no face found in any frame")
    metrics = {"missed": Value(faces.count(None) / len(faces))}
    if sequence.truth is not None:
        eyes = np.array(
            [np.full((2, 2), np.nan) if face is None else face.eyes_px * scale for face in faces]
        )
        metrics |= motion_errors(eyes, sequence.truth.eyes_px[: len(eyes)])
    upcoming = itertools.cycle(itertools.islice(frames(), REPETITION_FRAMES))
    detect = partial(cpu_ms, lambda: engine.detect(next(upcoming)), REPETITION_FRAMES)
    return metrics, lambda: {"cpu_ms": detect(time.process_time_ns)}
