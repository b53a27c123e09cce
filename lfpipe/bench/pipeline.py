"""Subject: whole sessions, and the paper's loop, in processes of their own. Error of the viewpoint
against CPU and latency.
"""

import contextlib
import itertools
import json
import subprocess
import sys
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
from lfpipe.bench.paper_loop import Loop
from lfpipe.bench.results import Figures, rms
from lfpipe.bench.runner import Candidate, Offer
from lfpipe.config import Render, converter, load
from lfpipe.config.check import flat
from lfpipe.files.safe_files import write_file
from lfpipe.scene.lightfield import LightField
from lfpipe.sequence.eyes import Truth
from lfpipe.sequence.folder import is_sequence
from lfpipe.track.models import package_folder

PAPER_ALPHA_PX = 12.0  # px of the camera per view: chosen by hand, as the paper does
STEADY_S = 1.0  # after the first picture every stage has started and found the face
LEAST_S, MAX_S = 1.0, 16.0  # of a measured session: enough for a median; the whole demo sequence
SIDES = ("left", "right")
# of an aligned trace
STEP_NS = 1_000_000
SKIP_NS = 1_000_000_000
STILL_MS = 400
Trace = list[dict[str, Any]]
Float = NDArray[np.float64]


@attrs.frozen
class SessionRun:
    """rows: of the trace. cpu_ms_s: CPU of all processes without the start, in ms per second.
    first_s: from the start of the process to its first picture.
    """

    rows: Trace
    cpu_ms_s: float
    first_s: float


def _cpu_ms() -> float:
    """CPU time of the living descendants of this process so far."""
    total = 0.0
    for one in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):  # it has ended
            total += 1e3 * sum(one.cpu_times()[:2])
    return total


def settings_of(file: str, sets: Sequence[str] = ()) -> dict[str, Any]:
    """Every key with its value, of a configuration file or a preset with changes."""
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
            # measure the requested quality even if it is too slow
            settings={**settings, "governor.quality": "fixed"},
        )
        with session:
            time.sleep(STEADY_S)
            begun_s = time.monotonic()
            used_ms = _cpu_ms()
            time.sleep(max(seconds - STEADY_S, LEAST_S))
            cpu_ms_s = (_cpu_ms() - used_ms) / (time.monotonic() - begun_s)
            session.stop()
            session.wait()  # raises if it failed
        rows = [json.loads(line) for line in trace.read_text().splitlines()]
        return SessionRun(rows, cpu_ms_s, (rows[0]["t_presented_ns"] - started_ns) / 1e9)


def run_loop(loop: Loop) -> SessionRun:
    """The paper's loop in a process of its own. Raises RuntimeError if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        loop = attrs.evolve(loop, trace=Path(folder, "trace.jsonl"))
        started_ns = time.monotonic_ns()
        command = [
            sys.executable,
            "-m",
            "lfpipe.bench.paper_loop",
            json.dumps(attrs.asdict(loop), default=str),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(
                f"the loop exited with {done.returncode}: {done.stderr.strip()[-300:]}"
            )
        rows = [json.loads(line) for line in loop.trace.read_text().splitlines()]
    steady = [
        row for row in rows if row["t_presented_ns"] > rows[0]["t_presented_ns"] + STEADY_S * 1e9
    ]
    if not steady:
        raise RuntimeError("the loop found no face")
    used_ns, span_ns = (steady[-1][name] - steady[0][name] for name in ("cpu_ns", "t_presented_ns"))
    return SessionRun(rows, 1e3 * used_ns / span_ns, (rows[0]["t_presented_ns"] - started_ns) / 1e9)


def write_views(field: LightField, folder: Path) -> Path:
    """Writes the views as PNG in row-major order for the loop, unless they exist."""
    if len(list(folder.glob("*.png"))) != field.rows * field.cols:
        folder.mkdir(parents=True, exist_ok=True)
        for index, place in enumerate(np.ndindex(field.rows, field.cols)):
            quick = [cv2.IMWRITE_PNG_COMPRESSION, 1]
            view = np.asarray(field.views)[0][place]
            picture = np.broadcast_to(view[::-1], (3, *view.shape[1:])).transpose(1, 2, 0)
            _, data = cv2.imencode(".png", np.ascontiguousarray(picture), quick)
            write_file(folder / f"view_{index:04d}.png", data.tobytes())
    return folder


def displayed_errors(
    truth: Truth,
    rows: Trace,
    alpha_px: float,
    centre_px: tuple[float, float],
    grid: tuple[int, int],
) -> dict[str, float]:
    """RMS over both eyes while they are visible, and while a picture is on the screen: error_views,
    the distance of the viewpoint on screen from that of the true eyes; error_px, of the eyes that
    the picture was made for; jitter_px, their deviation from the mean of each rest, from STILL_MS
    after its start, if there is any.

    rows: of a trace, in order; only the first round of a looped file and the time after SKIP_NS
    count, as every tracker searches for the face first. A picture's frame aligns the clocks: the
    truth at time t is the truth at the frame's own time plus t - t_sensor_ns. alpha_px, centre_px:
    of the mapping that made the trace. grid: rows, cols. Raises ValueError if nothing remains.
    """
    rows = [
        row
        for row in rows
        if row["t_presented_ns"] and row["eyes_used"] and row["source_seq"] < len(truth.t_ns)
    ]
    if not rows:
        raise ValueError("the trace holds no picture made for eyes")
    presented_ns = np.array([row["t_presented_ns"] for row in rows])
    offset_ns = truth.t_ns[[row["source_seq"] for row in rows]] - [
        row["t_sensor_ns"] for row in rows
    ]
    t_ns = np.arange(presented_ns[0] + SKIP_NS, presented_ns[-1], STEP_NS)
    now = np.searchsorted(presented_ns, t_ns, side="right") - 1
    true_ns = t_ns + offset_ns[now]
    visible = truth.sees(true_ns)
    true_px = truth.at(true_ns)
    if not visible.any():
        raise ValueError("the trace and the truth have no time in common")
    used_px = np.array([[row["eyes_used"][side] for side in SIDES] for row in rows])[now]
    drawn = np.maximum.accumulate(
        [k if row.get("composed", True) else 0 for k, row in enumerate(rows)]
    )
    on_screen = np.array([[row["view"][side] for side in SIDES] for row in rows], np.float64)[
        drawn[now]
    ]
    view_row = (grid[0] - 1) / 2 + (
        true_px[..., 1].mean(axis=1, keepdims=True).repeat(2, axis=1) - centre_px[1]
    ) / alpha_px
    view_col = (grid[1] - 1) / 2 + (centre_px[0] - true_px[..., 0]) / alpha_px
    true_view = np.clip(np.stack([view_row, view_col], axis=2), 0, np.array(grid) - 1)
    errors = {
        "error_views": _apart((on_screen - true_view)[visible]),
        "error_px": _apart((used_px - true_px)[visible]),
    }
    resting = visible & truth.still[np.searchsorted(truth.t_ns, true_ns, side="right") - 1]
    # the last sample in motion
    moved = np.maximum.accumulate(np.where(resting, -1, np.arange(len(now))))
    still = np.arange(len(now)) - moved > STILL_MS
    rests = [used_px[still & (moved == start)] for start in np.unique(moved[still])]
    return errors | (
        {"jitter_px": _apart(np.concatenate([rest - rest.mean(axis=0) for rest in rests]))}
        if rests
        else {}
    )


def _apart(offsets: Float) -> float:
    """RMS length of offsets (n, 2, 2)."""
    return rms(np.linalg.norm(offsets, axis=2))


def _alpha_px(inputs: Inputs) -> float:
    """px per view that keeps the eyes of the sequence within the grid, so that every method can
    show the correct view.
    """
    truth = inputs.sequence.truth
    field = inputs.field
    if truth is None or field.cols == 1:
        return PAPER_ALPHA_PX
    reach_px = float(
        np.abs(truth.eyes_px[truth.visible][:, :, 0] - inputs.sequence.size_px[0] / 2).max()
    )
    return max(PAPER_ALPHA_PX, reach_px / ((field.cols - 1) / 2))


def measure(inputs: Inputs) -> Iterator[Offer]:
    """Clock x method, the paper's configuration and its plain loop."""
    field = inputs.field
    sequence = inputs.sequence
    usual = Render()
    if field.rows * field.cols == 1:
        yield "pipeline: one view: nothing follows the eyes"
        return
    if sequence.truth is None:
        yield (
            f"error of the viewpoint shown: {sequence.path.name} has no truth; only latency and CPU"
            " are measured"
        )
    if inputs.quick:
        yield (
            "nearest views with the other settings of lfpipe: --quick shows them in the paper's"
            " configuration only"
        )
    best = field.method if field.method.startswith("warp") else "blend"
    if best == "blend":
        yield "warped views: the scene has no disparity, or blending is as good"
    alpha_px = _alpha_px(inputs)
    width_px, height_px = sequence.size_px
    common = {
        "render.alpha_px": round(alpha_px, 3),
        "camera.width_px": width_px,
        "camera.height_px": height_px,
    }
    seconds = min(STEADY_S + sequence.count / sequence.rate_hz, MAX_S)  # the sequence once

    def candidate(
        name: str, run: Callable[[], SessionRun], paper: bool = False, used: bool = False
    ) -> Candidate:
        turn = partial(_figures, inputs, run, alpha_px)
        return Candidate(
            curve=name,
            knob=f"{sequence.rate_hz:g} Hz",
            prepare=lambda: ({}, turn),
            paper=paper,
            used=used,
        )

    def session(settings: dict[str, Any]) -> Callable[[], SessionRun]:
        return partial(run_session, inputs.scene[0], sequence.path, seconds, settings | common)

    def loop() -> SessionRun:
        views = write_views(field, inputs.work / "views" / field.manifest.key)
        return run_loop(
            Loop(
                video=sequence.path,
                views=views,
                pace_hz=sequence.rate_hz,
                seconds=seconds,
                alpha_px=alpha_px,
                rows=field.rows,
                cols=field.cols,
                size_px=sequence.size_px,
            )
        )

    if package_folder() is None or is_sequence(sequence.path):
        yield (
            "paper as a plain loop: it needs mediapipe, which is not installed, or a video; its"
            " configuration runs"
        )
    else:
        yield candidate("paper as a plain loop", loop, True)
    yield candidate("paper's configuration", session(settings_of("paper")), True)
    for clock, method in itertools.product(
        ("display", "camera"), [best] if inputs.quick else ["nearest", best]
    ):
        run = session({"render.clock": clock, "render.method": method})
        yield candidate(
            f"{clock} clock, {method}", run, used=(clock, method) == (usual.clock, field.method)
        )


def _figures(inputs: Inputs, measured: Callable[[], SessionRun], alpha_px: float) -> Figures:
    run = measured()
    sequence = inputs.sequence
    field = inputs.field
    # before, the tracker looks for the face
    start_ns = run.rows[0]["t_presented_ns"] + STEADY_S * 1e9
    rows = [
        row for row in run.rows if row.get("composed", True) and row["t_presented_ns"] > start_ns
    ]
    p50_ms, p95_ms = np.percentile(
        [(row["t_presented_ns"] - row["t_sensor_ns"]) / 1e6 for row in rows], (50, 95)
    )
    figures = {
        "latency_ms": p50_ms,
        "latency_p95_ms": p95_ms,
        "cpu_ms_s": run.cpu_ms_s,
        "first_s": run.first_s,
    }
    if sequence.truth is not None:
        centre_px = sequence.size_px[0] / 2, sequence.size_px[1] / 2
        figures |= displayed_errors(
            sequence.truth, run.rows, alpha_px, centre_px, (field.rows, field.cols)
        )
    return figures
