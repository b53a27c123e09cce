"""Subject: the whole pipeline. Error of the viewpoint on screen against CPU and against latency."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from lfpipe.bench.eye_path import EyePath
from lfpipe.bench.inputs import MOVING_S, Inputs, demo_sequence
from lfpipe.bench.paper_loop import Loop
from lfpipe.bench.results import Candidate, Chart, Figure, Prepared, Skipped, Subject
from lfpipe.bench.sessions import SessionRun, parts, run_loop, run_session, write_views
from lfpipe.bench.trace_error import AlignedTrace
from lfpipe.config import Render
from lfpipe.track.models import package_folder

Turn = Mapping[str, float | list[float]]
PAPER_ALPHA_PX = 12.0
SKIPPED_S = 1.0  # after the first picture, while the tracker looks for the face
MAX_S = 16.0


def alpha_for(inputs: Inputs) -> float:
    """px per view that keeps the eyes of the sequence within the grid, so that every method can show the correct view."""
    truth, field = inputs.sequence.truth, inputs.field
    if truth is None or field.cols == 1:
        return PAPER_ALPHA_PX
    visible = truth.eyes_px[truth.visible_ns >= 0]
    reach_px = float(np.abs(visible[:, :, 0] - inputs.sequence.frames.shape[2] / 2).max())
    return max(PAPER_ALPHA_PX, reach_px / ((field.cols - 1) / 2))


def candidates(inputs: Inputs) -> Iterator[Candidate | Skipped]:
    """Camera rate x clock x method, the paper's configuration and its plain loop."""
    field, sequence = inputs.field, inputs.sequence
    if field.rows * field.cols == 1:
        yield Skipped("pipeline", "one view: nothing follows the eyes")
        return
    if sequence.truth is None:
        yield Skipped("error of the viewpoint shown", f"{sequence.path.name} has no truth; only latency and CPU are measured")
    alpha_px = alpha_for(inputs)
    rates = [sequence.rate_hz]
    if inputs.demo and not inputs.quick:
        rates += [rate for rate in (60.0, 120.0) if rate != sequence.rate_hz]
    else:
        why = "--quick runs one rate" if inputs.demo else "the sequence and its truth have one rate"
        yield Skipped("other camera rates", why)
    if inputs.quick:
        yield Skipped("nearest views with the other settings of lfpipe", "--quick shows them in the paper's configuration only")
    best = field.method if field.method.startswith("warp") else "blend"
    if best == "blend":
        yield Skipped("warped views", "the scene has no disparity, or blending is as good")
    has_facemesh = package_folder() is not None
    if not has_facemesh:
        yield Skipped("paper as a plain loop", "mediapipe is not installed; its configuration runs by litert")
    methods = [best] if inputs.quick else ["nearest", best]
    size = sequence.frames.shape[2], sequence.frames.shape[1]
    common = [f"--set=render.alpha_px={alpha_px:.3f}", f"--set=camera.width_px={size[0]}", f"--set=camera.height_px={size[1]}"]
    seconds = min(SKIPPED_S + len(sequence.frames) / sequence.rate_hz, MAX_S)  # the sequence once
    usual = Render()
    for rate_hz in rates:
        own = rate_hz == sequence.rate_hz
        video = sequence.path if own else demo_sequence(inputs.work, MOVING_S[1], rate_hz)
        figures = _figures(inputs, sequence.truth if own else EyePath.read(video.with_suffix(".csv")), alpha_px)

        def loop(video: Path = video, rate_hz: float = rate_hz, figures: Callable[[SessionRun], Turn] = figures) -> Prepared:
            views = write_views(field, inputs.work / "views" / str(field.manifest["key"]))
            given = Loop(video, views, rate_hz, seconds, alpha_px, field.rows, field.cols, size)
            return Prepared(dict, lambda: figures(run_loop(given)))

        def session(
            *options: str, video: Path = video, figures: Callable[[SessionRun], Turn] = figures
        ) -> Callable[[], Prepared]:
            return lambda: Prepared(dict, lambda: figures(run_session(inputs.scene, video, seconds, [*common, *options])))

        knob = f"{rate_hz:g} Hz"
        if has_facemesh:
            yield Candidate("paper as a plain loop", knob, loop, own)
        yield Candidate("paper's configuration", knob, session("--config", "paper"), own)
        for clock in ("display", "camera"):
            for method in methods:
                used = own and (clock, method) == (usual.clock, field.method)
                options = session(f"--set=render.clock={clock}", f"--set=render.method={method}")
                yield Candidate(f"{clock} clock, {method}", knob, options, False, used)


def _figures(inputs: Inputs, truth: EyePath | None, alpha_px: float) -> Callable[[SessionRun], Turn]:
    grid = inputs.field.rows, inputs.field.cols
    centre = inputs.sequence.frames.shape[2] / 2, inputs.sequence.frames.shape[1] / 2

    def figures(run: SessionRun) -> Turn:
        start_ns = run.rows[0]["t_presented_ns"] + SKIPPED_S * 1e9
        rows = [row for row in run.rows if row.get("composed", True) and row["t_presented_ns"] > start_ns]
        ages = [(row["t_presented_ns"] - row["t_sensor_ns"]) / 1e6 for row in rows]
        by_part = [float(np.median([(r["t_presented_ns"] - r["t_sensor_ns"]) / 1e6 for r in part])) for part in parts(rows)]
        found: dict[str, float | list[float]] = {"latency_ms": by_part or [float(np.median(ages))], "cpu_ms_s": run.cpu_ms_s}
        found |= {"latency_p95_ms": float(np.percentile(ages, 95)), "first_s": run.first_s}
        if truth is not None:
            trace = AlignedTrace(truth, run.rows)
            errors = trace.figures()
            found |= {"error_views": trace.view_error(alpha_px, centre, grid), "error_px": errors["error"]}
            if np.isfinite(errors["jitter"]):
                found["jitter_px"] = errors["jitter"]
        return found

    return figures


SUBJECT = Subject(
    "pipeline",
    "The whole pipeline",
    "Sessions of `lfpipe up` and the paper as one plain loop, on the same sequence and scene. How far is the viewpoint on screen"
    " from the eyes at that moment, over all display time? How much CPU does it take? How old is the frame behind a picture?"
    " All of them decode the video while they run.",
    (
        Figure("error_views", "error of the viewpoint shown, RMS", "views"),
        Figure("error_px", "error of the eyes the picture was made for, RMS", "px"),
        Figure("jitter_px", "still jitter, RMS", "px"),
        Figure("latency_ms", "frame captured to picture shown, p50", "ms"),
        Figure("latency_p95_ms", "frame captured to picture shown, p95", "ms"),
        Figure("cpu_ms_s", "CPU of all processes", "ms per second"),
        Figure("first_s", "start to first picture", "s"),
    ),
    (
        Chart("pipeline-cpu", "Error of the viewpoint shown against CPU", "cpu_ms_s", "error_views"),
        Chart("pipeline-latency", "Error of the viewpoint shown against latency", "latency_ms", "error_views"),
        Chart("pipeline-cost", "Latency against CPU", "cpu_ms_s", "latency_ms"),
    ),
    candidates,
    paper="its configuration (`--config paper`), and the same as one plain loop",
    needs=("scene", "sequence"),
    budget_s=(1.0, 400.0),
    turns=(1, 3),
)
