"""Subject: the whole pipeline: error of the viewpoint shown against CPU and against motion-to-display latency."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from lfpipe.bench.displayed import Displayed
from lfpipe.bench.inputs import MOVING_S, Inputs, demo_sequence
from lfpipe.bench.model import Candidate, Diagram, Figure, Prepared, Skipped, Subject, Turn
from lfpipe.bench.paper_loop import Loop
from lfpipe.bench.sessions import Ran, parts, run_loop, run_session, write_views
from lfpipe.bench.truth import Truth

PAPER_ALPHA_PX = 12.0
SKIPPED_S = 1.0  # after the first picture: the face has to be found first


def alpha_for(inputs: Inputs) -> float:
    """px per view that keeps the sequence's eyes within the grid: then every method could show what the eyes should see."""
    truth, field = inputs.sequence.truth, inputs.field
    if truth is None or field.cols == 1:
        return PAPER_ALPHA_PX
    frames = inputs.sequence.frames
    seen = truth.eyes_px[truth.visible_ns >= 0]
    away_px = float(np.abs(seen[:, :, 0] - frames.shape[2] / 2).max())
    return max(PAPER_ALPHA_PX, away_px / ((field.cols - 1) / 2))


def candidates(inputs: Inputs) -> Iterator[Candidate | Skipped]:
    """Camera rate x clock x method, the paper's configuration and its plain loop."""
    field, sequence = inputs.field, inputs.sequence
    if field.rows * field.cols == 1:
        yield Skipped("pipeline", "one view: nothing follows the eyes")
        return
    if sequence.truth is None:
        yield Skipped(
            "error of the viewpoint shown", f"{sequence.path.name} has no truth beside it; latency and CPU are measured"
        )
    alpha_px = alpha_for(inputs)
    by_hand = [f"--set=render.alpha_px={alpha_px:.3f}"]
    rates = [sequence.rate_hz]
    if inputs.demo and not inputs.quick:
        rates += [rate for rate in (60.0, 120.0) if rate != sequence.rate_hz]
    else:
        why = "--quick runs one rate" if inputs.demo else "the sequence has one rate, and its truth with it"
        yield Skipped("other camera rates", why)
    if inputs.quick:
        yield Skipped("nearest views with the other settings of lfpipe", "--quick shows them in the paper's configuration only")
    best = field.method if field.method.startswith("warp") else "blend"
    methods = ["nearest", best]
    if not best.startswith("warp"):
        yield Skipped("warped views", "the scene has no disparity, or is met as well without")
    for rate_hz in rates:
        video = sequence.path if rate_hz == sequence.rate_hz else demo_sequence(inputs.work, MOVING_S[1], rate_hz)
        truth = sequence.truth if rate_hz == sequence.rate_hz else Truth.read(video.with_suffix(".csv"))
        seconds = _seconds(inputs)
        measure = _measure(inputs, truth, alpha_px)
        knob = f"{rate_hz:g} Hz"

        def loop(v: Path = video, r: float = rate_hz, s: float = seconds, m: Callable[[Ran], Turn] = measure) -> Prepared:
            views = write_views(field, inputs.work / "views" / str(field.manifest["key"]))
            size = (sequence.frames.shape[2], sequence.frames.shape[1])
            given = Loop(v, views, r, s, 5, alpha_px, field.rows, field.cols, size, decode=True)
            return Prepared(dict, lambda: m(run_loop(given)))

        def session(
            options: list[str], v: Path = video, s: float = seconds, m: Callable[[Ran], Turn] = measure
        ) -> Callable[[], Prepared]:
            return lambda: Prepared(dict, lambda: m(run_session(inputs.scene, v, s, [*by_hand, *options])))

        size = [f"--set=camera.width_px={sequence.frames.shape[2]}", f"--set=camera.height_px={sequence.frames.shape[1]}"]
        own = rate_hz == sequence.rate_hz
        yield Candidate("paper as a plain loop", knob, loop, own)
        yield Candidate("paper's configuration", knob, session([*size, "--config", "paper"]), own)
        for clock in ("display", "camera"):
            for method in methods:
                if inputs.quick and method == "nearest":
                    continue
                chosen = [f"--set=render.clock={clock}", f"--set=render.method={method}"]
                yield Candidate(f"{clock} clock, {method}", knob, session([*size, *chosen]))


def _seconds(inputs: Inputs) -> float:
    """From the first picture: the sequence once, after what is skipped."""
    return min(SKIPPED_S + len(inputs.sequence.frames) / inputs.sequence.rate_hz, 16.0)


def _measure(inputs: Inputs, truth: Truth | None, alpha_px: float) -> Callable[[Ran], Turn]:
    grid = inputs.field.rows, inputs.field.cols
    centre = inputs.sequence.frames.shape[2] / 2, inputs.sequence.frames.shape[1] / 2

    def figures(ran: Ran) -> Turn:
        start_ns = ran.rows[0]["t_presented_ns"] + SKIPPED_S * 1e9
        rows = [row for row in ran.rows if row.get("composed", True) and row["t_presented_ns"] > start_ns]
        ages = [(row["t_presented_ns"] - row["t_sensor_ns"]) / 1e6 for row in rows]
        by_part = [float(np.median([(r["t_presented_ns"] - r["t_sensor_ns"]) / 1e6 for r in part])) for part in parts(rows)]
        found: dict[str, float | list[float]] = {"latency_ms": by_part or [float(np.median(ages))], "cpu_ms_s": ran.cpu_ms_s}
        found |= {"latency_p95_ms": float(np.percentile(ages, 95)), "first_s": ran.first_s}
        if truth is not None:
            beside = Displayed(truth, ran.rows)
            told = beside.figures()
            found |= {"error_views": beside.view_error(alpha_px, centre, grid), "error_px": told["error"]}
            if np.isfinite(told["jitter"]):
                found["jitter_px"] = told["jitter"]
        return found

    return figures


SUBJECT = Subject(
    "pipeline",
    "The whole pipeline",
    "Sessions of `lfpipe up` and the paper as one plain loop on the same sequence and scene: how far is the viewpoint shown from"
    " where the eyes are at that moment, over all display time; what CPU does it take,"
    " and how old is the frame behind a picture? All of them decode the video as it runs.",
    (
        Figure("error_views", "error of the viewpoint shown, RMS", "views"),
        Figure("error_px", "error of the eyes a picture was made for, RMS", "px"),
        Figure("jitter_px", "still jitter, RMS", "px"),
        Figure("latency_ms", "frame taken to picture shown, p50", "ms"),
        Figure("latency_p95_ms", "frame taken to picture shown, p95", "ms"),
        Figure("cpu_ms_s", "CPU of all processes", "ms per second"),
        Figure("first_s", "start to first picture", "s"),
    ),
    (
        Diagram("pipeline-cpu", "Error of the viewpoint shown against CPU", "cpu_ms_s", "error_views"),
        Diagram(
            "pipeline-latency", "Error of the viewpoint shown against latency", "latency_ms", "error_views", "latency_p95_ms"
        ),
        Diagram("pipeline-cost", "Latency against CPU", "cpu_ms_s", "latency_ms"),
    ),
    candidates,
    paper="its configuration (`--config paper`), and the same as one plain loop",
    budget_s=(1.0, 400.0),
    turns=(1, 3),
)
