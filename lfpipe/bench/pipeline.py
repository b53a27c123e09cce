"""Benchmark: whole sessions, and the paper's loop, in processes of their own: error of the
viewpoint against CPU and latency.
"""

import contextlib
import itertools
import json
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
import psutil
from numpy.typing import NDArray

from lfpipe.api.session import Session
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.paper_loop import PAPER_ALPHA_PX, SIDES, Loop
from lfpipe.bench.results import Metrics, rms
from lfpipe.bench.runner import Offer, Prepared, Variant
from lfpipe.bench.simulator.run import viewpoints
from lfpipe.config import Render, converter, load
from lfpipe.config.check import flat
from lfpipe.files.safe_files import trace_lines, write_file
from lfpipe.host.worker import python
from lfpipe.scene.lightfield import LightField
from lfpipe.sequence.folder import is_sequence
from lfpipe.sequence.packets import Truth
from lfpipe.track.models import has_face_mesh

STEADY_S = 1.0  # after the first picture every stage has started and found the face
MIN_S, MAX_S = 1.0, 16.0  # of a measured session: enough for a median; the whole demo sequence
# of an aligned trace
STEP_NS = 1_000_000
SKIP_NS = 1_000_000_000
STILL_MS = 400
Trace = list[dict[str, Any]]
Float = NDArray[np.float64]


@attrs.frozen
class SessionRun:
    """The pictures that a process showed, and their cost."""

    rows: Trace
    started_ns: int
    """Start time of the process."""
    cpu_ms_s: float
    """CPU time of all processes, without startup, in ms per second."""

    @property
    def first_s(self) -> float:
        """Time from the start of the process to its first picture."""
        return float(self.rows[0]["t_presented_ns"] - self.started_ns) / 1e9

    @property
    def steady(self) -> Trace:
        """The rows from STEADY_S after the first picture on."""
        start_ns = self.rows[0]["t_presented_ns"] + STEADY_S * 1e9
        return [row for row in self.rows if row["t_presented_ns"] > start_ns]


def _cpu_ms() -> float:
    """CPU time of the living descendants of this process so far."""
    total = 0.0
    for one in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):  # it has ended
            total += 1e3 * sum(one.cpu_times()[:2])
    return total


def settings_of(file: str, sets: Sequence[str] = ()) -> dict[str, Any]:
    """All keys with their values, of a configuration file or a preset with changes."""
    return {str(key): value for key, value in flat(converter().unstructure(load(file, sets)))}


def run_session(
    scene: Path, video: Path, seconds: float, settings: Mapping[str, Any], pace: str = ""
) -> SessionRun:
    """A session on a scene and a video without a display, for `seconds` from its first picture on.

    pace: of the video, in Hz, or "max". Raises UserError if the session fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder, "trace.jsonl")
        started_ns = time.monotonic_ns()
        session = Session(
            scene,
            camera=f"file:{video}?loop=1" + (f"&pace={pace}" if pace else ""),
            display="none",
            trace=trace,
            # measure the requested quality even if the machine is too slow for it
            settings={**settings, "governor.quality": "fixed"},
        )
        with session:
            time.sleep(STEADY_S)
            begun_s = time.monotonic()
            used_ms = _cpu_ms()
            time.sleep(max(seconds - STEADY_S, MIN_S))
            cpu_ms_s = (_cpu_ms() - used_ms) / (time.monotonic() - begun_s)
            session.stop()
            session.wait()  # raises if it failed
        return SessionRun(_rows(trace), started_ns, cpu_ms_s)


def run_loop(loop: Loop) -> SessionRun:
    """The paper's loop in a process of its own. Raises RuntimeError if it fails."""
    started_ns = time.monotonic_ns()
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder, "trace.jsonl")
        options = json.dumps(attrs.asdict(loop) | {"trace": str(trace)})
        command = python("lfpipe.bench.paper_loop", options)
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            why = done.stderr.strip()[-300:]
            raise RuntimeError(f"the loop exited with {done.returncode}: {why}")
        rows = _rows(trace)
    if not rows:
        raise RuntimeError("the loop found no face")
    run = SessionRun(rows, started_ns, 0.0)
    first, *_, last = run.steady
    used_ns, span_ns = (last[name] - first[name] for name in ("cpu_ns", "t_presented_ns"))
    return attrs.evolve(run, cpu_ms_s=1e3 * used_ns / span_ns)


def _rows(trace: Path) -> Trace:
    return [dict(fields.values) for fields in trace_lines(trace, "measure again")]


def write_views(field: LightField, folder: Path) -> Path:
    """Writes the views as PNG in row-major order for the loop, unless they exist."""
    if len(list(folder.glob("*.png"))) != field.rows * field.cols:
        for index, place in enumerate(np.ndindex(field.rows, field.cols)):
            view = np.asarray(field.views)[0][place]
            picture = np.broadcast_to(view[::-1], (3, *view.shape[1:])).transpose(1, 2, 0)
            quick = [cv2.IMWRITE_PNG_COMPRESSION, 1]
            _, data = cv2.imencode(".png", np.ascontiguousarray(picture), quick)
            write_file(folder / f"view_{index:04d}.png", data.tobytes())
    return folder


def displayed_errors(
    truth: Truth,
    rows: Trace,
    alpha_px: float,
    centre_px: tuple[float, float],
    grid: tuple[int, int],
) -> Metrics:
    """RMS errors over both eyes while they are visible and a picture is on the screen: error_views,
    the distance between the viewpoint on screen and that of the true eyes; error_px, of the eyes
    that the picture was rendered for; jitter_px, their deviation from the mean of each rest, from
    STILL_MS after its start, if there is any.

    rows: of a trace, in order; only the first round of a looped file and the time after SKIP_NS
    count, because every tracker first searches for the face. A picture's frame aligns the clocks:
    the truth at time t is the truth at the frame's own time plus t - t_sensor_ns. alpha_px,
    centre_px: of the mapping that made the trace. grid: rows, cols. Raises ValueError if no row
    remains.
    """
    rows = [
        row
        for row in rows
        if row["t_presented_ns"] and row["eyes_used"] and row["source_seq"] < len(truth.t_ns)
    ]
    if not rows:
        raise ValueError("the trace contains no picture with eyes")
    presented_ns = np.array([row["t_presented_ns"] for row in rows])
    sensor_ns = np.array([row["t_sensor_ns"] for row in rows])
    offset_ns = truth.t_ns[[row["source_seq"] for row in rows]] - sensor_ns
    t_ns = np.arange(presented_ns[0] + SKIP_NS, presented_ns[-1], STEP_NS)
    now = np.searchsorted(presented_ns, t_ns, side="right") - 1
    true_ns = t_ns + offset_ns[now]
    visible = truth.sees(true_ns)
    if not visible.any():
        raise ValueError("the trace and the truth have no time in common")
    true_px = truth.at(true_ns)
    used_px = _pairs(rows, "eyes_used")[now]
    composed = [row["composed"] for row in rows]
    drawn = np.maximum.accumulate(np.where(composed, np.arange(len(rows)), 0))
    on_screen = _pairs(rows, "view")[drawn[now]]
    right = np.clip(viewpoints(true_px, alpha_px, centre_px, grid), 0, np.array(grid) - 1)
    errors = {
        "error_views": _eye_distance((on_screen - right)[visible]),
        "error_px": _eye_distance((used_px - true_px)[visible]),
    }
    resting = visible & truth.still[np.searchsorted(truth.t_ns, true_ns, side="right") - 1]
    # the last sample in motion
    moved = np.maximum.accumulate(np.where(resting, -1, np.arange(len(now))))
    still = np.arange(len(now)) - moved > STILL_MS
    rests = [used_px[still & (moved == start)] for start in np.unique(moved[still])]
    if rests:
        off = np.concatenate([rest - rest.mean(axis=0) for rest in rests])
        errors["jitter_px"] = _eye_distance(off)
    return errors


def _pairs(rows: Trace, name: str) -> Float:
    """A field of a trace for both eyes, (n, 2, 2)."""
    return np.array([[row[name][side] for side in SIDES] for row in rows], np.float64)


def _eye_distance(offsets: Float) -> float:
    """RMS length of offsets (n, 2, 2)."""
    return rms(np.linalg.norm(offsets, axis=2))


def _alpha_px(inputs: Inputs) -> float:
    """px per view at which the eyes of the sequence stay within the grid, so that every method can
    show the correct view.
    """
    truth = inputs.sequence.truth
    cols = inputs.field.cols
    if truth is None or cols == 1:
        return PAPER_ALPHA_PX
    off_px = truth.eyes_px[truth.visible][:, :, 0] - inputs.sequence.size_px[0] / 2
    return max(PAPER_ALPHA_PX, float(np.abs(off_px).max()) / ((cols - 1) / 2))


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Yields clock x method, the paper's configuration, and its plain loop."""
    field = inputs.field
    sequence = inputs.sequence
    if field.rows * field.cols == 1:
        yield "pipeline: with one view, no picture depends on the eyes"
        return
    if sequence.truth is None:
        yield (
            f"error of the viewpoint shown: {sequence.path.name} has no ground truth; only latency"
            " and CPU are measured"
        )
    if inputs.quick:
        yield (
            "nearest views with the other settings of lfpipe: --quick shows them in the paper's"
            " configuration only"
        )
    best = field.method if field.method.startswith("warp") else "blend"
    if best == "blend":
        yield "warped views: the scene has no disparity, or blending is equally good"
    alpha_px = _alpha_px(inputs)
    width_px, height_px = sequence.size_px
    common = {
        "render.alpha_px": round(alpha_px, 3),
        "camera.width_px": width_px,
        "camera.height_px": height_px,
    }
    seconds = min(STEADY_S + sequence.count / sequence.rate_hz, MAX_S)  # the sequence once
    runs: dict[str, Callable[[], SessionRun]] = {}
    if not has_face_mesh() or is_sequence(sequence.path):
        yield (
            "paper as a plain loop: it needs mediapipe's FaceMesh and a video; its"
            " configuration runs"
        )
    else:
        runs["paper as a plain loop"] = partial(_loop, inputs, seconds, alpha_px)
    session = partial(run_session, inputs.scene, sequence.path, seconds)
    runs["paper's configuration"] = partial(session, settings_of("paper") | common)
    methods = [best] if inputs.quick else ["nearest", best]
    for clock, method in itertools.product(("display", "camera"), methods):
        settings = common | {"render.clock": clock, "render.method": method}
        runs[f"{clock} clock, {method}"] = partial(session, settings)
    for name, run in runs.items():
        yield Variant(
            curve=name,
            parameter=f"{sequence.rate_hz:g} Hz",
            prepare=partial(_prepare, inputs, run, alpha_px),
            paper=name.startswith("paper"),
            used=name == f"{Render().clock} clock, {field.method}",
        )


def _loop(inputs: Inputs, seconds: float, alpha_px: float) -> SessionRun:
    field = inputs.field
    return run_loop(
        Loop(
            video=str(inputs.sequence.path),
            views=str(write_views(field, inputs.work / "views" / field.manifest.key)),
            pace_hz=inputs.sequence.rate_hz,
            seconds=seconds,
            alpha_px=alpha_px,
            grid=(field.rows, field.cols),
            size_px=inputs.sequence.size_px,
        )
    )


def _prepare(inputs: Inputs, run: Callable[[], SessionRun], alpha_px: float) -> Prepared:
    return {}, lambda: _metrics(inputs, run(), alpha_px)


def _metrics(inputs: Inputs, run: SessionRun, alpha_px: float) -> Metrics:
    sequence = inputs.sequence
    ages_ms = [
        (row["t_presented_ns"] - row["t_sensor_ns"]) / 1e6 for row in run.steady if row["composed"]
    ]
    p50_ms, p95_ms = np.percentile(ages_ms, (50, 95)).tolist()
    metrics = {
        "latency_ms": p50_ms,
        "latency_p95_ms": p95_ms,
        "cpu_ms_s": run.cpu_ms_s,
        "first_s": run.first_s,
    }
    if sequence.truth is not None:
        centre_px = sequence.size_px[0] / 2, sequence.size_px[1] / 2
        grid = inputs.field.rows, inputs.field.cols
        metrics |= displayed_errors(sequence.truth, run.rows, alpha_px, centre_px, grid)
    return metrics
