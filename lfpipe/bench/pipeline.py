"""Subject: whole sessions, and the paper's loop, in processes of their own. Error of the viewpoint against CPU and latency."""

import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
import psutil
from numpy.typing import NDArray

from lfpipe.bench.anaglyph import view_bgr
from lfpipe.bench.inputs import MOVING_S, Inputs, demo_sequence, eyes_at
from lfpipe.bench.paper_loop import Loop
from lfpipe.bench.runner import Candidate, Found
from lfpipe.config import Render
from lfpipe.host.files import exists
from lfpipe.scene.lightfield import LightField
from lfpipe.sequence.eyes import Truth, table_of
from lfpipe.track.models import package_folder

PAPER_ALPHA_PX = 12.0
STEADY_S = 1.0  # after the first picture every stage has started and found the face
POLL_S, START_S, MAX_S = 0.05, 90.0, 16.0
PART_S = 0.5  # of a run: differences between its parts are its noise
SIDES = ("left", "right")
SETTLE_NS, STILL_NS, STEP_NS, SKIP_NS = 500_000_000, 400_000_000, 1_000_000, 1_000_000_000  # of an aligned trace
Trace = list[dict[str, Any]]
Float = NDArray[np.float64]


@attrs.frozen
class SessionRun:
    """rows: of the trace. cpu_ms_s: CPU of all processes in each PART_S without the start, in ms per second. first_s: from the
    start of the process to its first picture."""

    rows: Trace
    cpu_ms_s: list[float]
    first_s: float


def _cpu_ns(process: psutil.Process) -> int:
    """CPU time of a process and its living descendants so far, by their own clocks, which count in ns."""
    total = 0
    for one in [process, *process.children(recursive=True)]:
        try:
            total += time.clock_gettime_ns((~one.pid << 3) | 2)  # clock_getcpuclockid(3)
        except OSError:  # it has ended
            continue
    return total


def _cpu_parts(pid: int, seconds: float) -> list[float]:
    """CPU of a process tree in ms per second, for each PART_S of the next seconds."""
    process, marks = psutil.Process(pid), []
    for _ in range(int(seconds / PART_S) + 1):
        marks.append((time.monotonic_ns(), _cpu_ns(process)))
        time.sleep(PART_S)
    return [1e3 * (used1 - used0) / (t1 - t0) for (t0, used0), (t1, used1) in itertools.pairwise(marks)]


def _read_trace(trace: Path) -> Trace:
    """The complete lines of a trace."""
    text = trace.read_text() if exists(trace) else ""
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


def parts(rows: Trace) -> list[Trace]:
    """Rows of a trace by the PART_S in which they were shown, without an incomplete last part."""
    grouped: dict[int, Trace] = {}
    for row in rows:
        grouped.setdefault(int((row["t_presented_ns"] - rows[0]["t_presented_ns"]) / (PART_S * 1e9)), []).append(row)
    return list(grouped.values())[:-1]


def run_session(scene: Path, video: Path, seconds: float, options: Sequence[str], pace: str = "") -> SessionRun:
    """`lfpipe up` on a scene and a video without a display, for `seconds` from its first picture on.

    options: of the command line. pace: of the video, in Hz, or "max". Raises RuntimeError if the session fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder, "trace.jsonl")
        camera = f"file:{video}?loop=1" + (f"&pace={pace}" if pace else "")
        command = [sys.executable, "-m", "lfpipe", "up", str(scene), "--camera", camera]
        command += ["--set=governor.quality=fixed"]  # measure the requested quality even if it is too slow
        command += ["--display", "none", "--trace", str(trace), "--session", f"bench{os.getpid()}x{time.monotonic_ns() % 10**6}"]
        started_ns = time.monotonic_ns()
        process = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            while process.poll() is None and not (exists(trace) and trace.stat().st_size):
                if time.monotonic_ns() - started_ns > START_S * 1e9:
                    raise RuntimeError(f"no picture within {START_S:g} s")
                time.sleep(POLL_S)
            time.sleep(STEADY_S)
            cpu = _cpu_parts(process.pid, max(seconds - STEADY_S, 2 * PART_S))
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=30)
        finally:
            if process.poll() is None:
                process.kill()
                process.communicate()
        if process.returncode:
            raise RuntimeError(f"`lfpipe up` exited with {process.returncode}: {err.strip()[-300:]}")
        rows = _read_trace(trace)
        return SessionRun(rows, cpu, (rows[0]["t_presented_ns"] - started_ns) / 1e9)


def run_loop(loop: Loop) -> SessionRun:
    """The paper's loop in a process of its own. Raises RuntimeError if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        loop = attrs.evolve(loop, trace=Path(folder, "trace.jsonl"))
        started_ns = time.monotonic_ns()
        command = [sys.executable, "-m", "lfpipe.bench.paper_loop", json.dumps(attrs.asdict(loop), default=str)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"the loop exited with {done.returncode}: {done.stderr.strip()[-300:]}")
        rows = _read_trace(loop.trace)
    if not rows:
        raise RuntimeError("the loop found no face")
    steady = [row for row in rows if row["t_presented_ns"] > rows[0]["t_presented_ns"] + STEADY_S * 1e9]
    ends = [part[-1] for part in parts(steady)]
    cpu = [1e3 * (b["cpu_ns"] - a["cpu_ns"]) / (b["t_presented_ns"] - a["t_presented_ns"]) for a, b in itertools.pairwise(ends)]
    return SessionRun(rows, cpu, (rows[0]["t_presented_ns"] - started_ns) / 1e9)


def write_views(field: LightField, folder: Path) -> Path:
    """Writes the views as PNG in row-major order for the loop, unless they exist."""
    if len(list(folder.glob("*.png"))) != field.rows * field.cols:
        folder.mkdir(parents=True, exist_ok=True)
        for index, place in enumerate(np.ndindex(field.rows, field.cols)):
            cv2.imwrite(str(folder / f"view_{index:04d}.png"), view_bgr(field, *place), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return folder


def _since_ns(truth: Truth, state: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Per row of the truth, the time from which a state has held; -1 where it does not."""
    starts = state & ~np.concatenate([[False], state[:-1]])
    return np.where(state, np.maximum.accumulate(np.where(starts, truth.t_ns, truth.t_ns[0])), -1)


class AlignedTrace:
    """A trace aligned with the true eyes, sampled every STEP_NS while a picture is on the screen.

    rows: of a trace, in order. A picture stays on the screen from its t_presented_ns until the next one's. Its frame aligns the
    clocks: the truth at time t is the truth at the frame's own time plus t - t_sensor_ns. Two parts do not count: the first
    SKIP_NS, in which every tracker searches for the face, and SETTLE_NS after a looped file restarts, where the head jumps as no
    real head does. Raises ValueError if nothing remains.
    """

    def __init__(self, truth: Truth, rows: Trace) -> None:
        self.rows = rows = [row for row in rows if row["t_presented_ns"] and row["eyes_used"]]
        if not rows:
            raise ValueError("the trace holds no picture made for eyes")
        presented_ns = np.array([row["t_presented_ns"] for row in rows])
        offset_ns = truth.t_ns[[row["source_seq"] % len(truth.t_ns) for row in rows]] - [row["t_sensor_ns"] for row in rows]
        t_ns = np.arange(presented_ns[0] + SKIP_NS, presented_ns[-1], STEP_NS)
        now = np.searchsorted(presented_ns, t_ns, side="right") - 1
        true_ns = t_ns + offset_ns[now]
        first_round = np.array([row["source_seq"] < len(truth.t_ns) for row in rows])[now]
        inside = (true_ns >= np.where(first_round, 0, SETTLE_NS)) & (true_ns <= truth.t_ns[-1])
        self.now: NDArray[np.intp] = now[inside]
        true_ns = true_ns[inside]
        if not len(true_ns):
            raise ValueError("the trace and the truth have no time in common")
        row = np.searchsorted(truth.t_ns, true_ns, side="right") - 1
        self.true_px = eyes_at(truth, true_ns)
        self.visible: NDArray[np.bool_] = truth.visible[row]
        self.still_since_ns = _since_ns(truth, truth.visible & truth.still)[row]
        self.still = (self.still_since_ns >= 0) & (true_ns - self.still_since_ns > STILL_NS)
        self.used_px = np.array([[row["eyes_used"][side] for side in SIDES] for row in rows], np.float64)
        self.drawn = np.maximum.accumulate([i if row.get("composed", True) else 0 for i, row in enumerate(rows)])

    def figures(self) -> dict[str, float]:
        """RMS in px over both eyes. error: while both eyes are visible. jitter: deviation from the mean of each period in which
        the head rests, from STILL_NS after its start; NaN if it never rests."""
        error = self.used_px[self.now] - self.true_px
        deviation = np.zeros_like(self.true_px)
        for start_ns in np.unique(self.still_since_ns[self.still]):
            rest = self.still & (self.still_since_ns == start_ns)
            deviation[rest] = self.used_px[self.now[rest]] - self.used_px[self.now[rest]].mean(axis=0)
        return {"error": _rms(error, self.visible), "jitter": _rms(deviation, self.still)}

    def view_error(self, alpha_px: float, centre_px: tuple[float, float], grid: tuple[int, int]) -> float:
        """RMS distance, in views, between the viewpoint on screen and that of the true eyes, over both eyes.

        alpha_px, centre_px: of the mapping that made the trace. grid: rows, cols.
        """
        on_screen = np.array([[row["view"][side] for side in SIDES] for row in self.rows], np.float64)[self.drawn[self.now]]
        rows = (grid[0] - 1) / 2 + (self.true_px[:, :, 1].mean(axis=1, keepdims=True) - centre_px[1]) / alpha_px
        cols = (grid[1] - 1) / 2 + (centre_px[0] - self.true_px[:, :, 0]) / alpha_px
        true = np.stack([np.clip(np.broadcast_to(rows, cols.shape), 0, grid[0] - 1), np.clip(cols, 0, grid[1] - 1)], axis=2)
        return _rms(on_screen - true, self.visible)


def _rms(values: Float, where: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.square(values[where]).sum(axis=(1, 2)).mean() / 2)) if where.any() else float("nan")


def _alpha_px(inputs: Inputs) -> float:
    """px per view that keeps the eyes of the sequence within the grid, so that every method can show the correct view."""
    truth, field = inputs.sequence.truth, inputs.field
    if truth is None or field.cols == 1:
        return PAPER_ALPHA_PX
    reach_px = float(np.abs(truth.eyes_px[truth.visible][:, :, 0] - inputs.sequence.frames.shape[2] / 2).max())
    return max(PAPER_ALPHA_PX, reach_px / ((field.cols - 1) / 2))


def measure(inputs: Inputs) -> Iterator[Found]:
    """Camera rate x clock x method, the paper's configuration and its plain loop."""
    field, sequence, usual = inputs.field, inputs.sequence, Render()
    if field.rows * field.cols == 1:
        yield "pipeline: one view: nothing follows the eyes"
        return
    if sequence.truth is None:
        yield f"error of the viewpoint shown: {sequence.path.name} has no truth; only latency and CPU are measured"
    alpha_px, rates = _alpha_px(inputs), [sequence.rate_hz]
    if inputs.demo and not inputs.quick:
        rates += [rate for rate in (60.0, 120.0) if rate != sequence.rate_hz]
    else:
        yield f"other camera rates: {'--quick runs one rate' if inputs.demo else 'the sequence and its truth have one rate'}"
    if inputs.quick:
        yield "nearest views with the other settings of lfpipe: --quick shows them in the paper's configuration only"
    best = field.method if field.method.startswith("warp") else "blend"
    if best == "blend":
        yield "warped views: the scene has no disparity, or blending is as good"
    if package_folder() is None:
        yield "paper as a plain loop: mediapipe is not installed; its configuration runs by litert"
    height_px, width_px = sequence.frames.shape[1:3]
    common = [f"--set=render.alpha_px={alpha_px:.3f}", f"--set=camera.width_px={width_px}", f"--set=camera.height_px={height_px}"]
    seconds = min(STEADY_S + len(sequence.frames) / sequence.rate_hz, MAX_S)  # the sequence once
    for rate_hz in rates:
        own, knob = rate_hz == sequence.rate_hz, f"{rate_hz:g} Hz"
        video = sequence.path if own else demo_sequence(inputs.work, MOVING_S[1], rate_hz)
        truth = sequence.truth if own else table_of(video.with_suffix(".csv"))

        def candidate(
            curve: str, run: Callable[[], SessionRun], paper: bool = False, used: bool = False, knob: str = knob,
            truth: Truth | None = truth,
        ) -> Candidate:  # fmt: skip
            return Candidate(curve, knob, lambda: ({}, lambda: _figures(inputs, run(), truth, alpha_px)), paper, used)

        def session(*options: str, video: Path = video) -> Callable[[], SessionRun]:
            return lambda: run_session(inputs.scene, video, seconds, [*common, *options])

        def loop(video: Path = video, rate_hz: float = rate_hz) -> SessionRun:
            views = write_views(field, inputs.work / "views" / str(field.manifest["key"]))
            return run_loop(Loop(video, views, rate_hz, seconds, alpha_px, field.rows, field.cols, (width_px, height_px)))

        if package_folder() is not None:
            yield candidate("paper as a plain loop", loop, own)
        yield candidate("paper's configuration", session("--config", "paper"), own)
        for clock, method in itertools.product(("display", "camera"), [best] if inputs.quick else ["nearest", best]):
            used = own and (clock, method) == (usual.clock, field.method)
            options = session(f"--set=render.clock={clock}", f"--set=render.method={method}")
            yield candidate(f"{clock} clock, {method}", options, used=used)


def _figures(inputs: Inputs, run: SessionRun, truth: Truth | None, alpha_px: float) -> Mapping[str, float | list[float]]:
    start_ns = run.rows[0]["t_presented_ns"] + STEADY_S * 1e9  # before, the tracker looks for the face

    def ages_ms(rows: Trace) -> list[float]:
        return [(row["t_presented_ns"] - row["t_sensor_ns"]) / 1e6 for row in rows]

    rows = [row for row in run.rows if row.get("composed", True) and row["t_presented_ns"] > start_ns]
    latency_ms = [float(np.median(ages_ms(part))) for part in parts(rows)] or [float(np.median(ages_ms(rows)))]
    p95_ms = float(np.percentile(ages_ms(rows), 95))
    figures: dict[str, float | list[float]] = {
        "latency_ms": latency_ms,
        "cpu_ms_s": run.cpu_ms_s,
        "latency_p95_ms": p95_ms,
        "first_s": run.first_s,
    }
    if truth is not None:
        trace = AlignedTrace(truth, run.rows)
        centre_px = inputs.sequence.frames.shape[2] / 2, inputs.sequence.frames.shape[1] / 2
        errors = trace.figures()
        figures["error_views"] = trace.view_error(alpha_px, centre_px, (inputs.field.rows, inputs.field.cols))
        figures["error_px"] = errors["error"]
        figures |= {"jitter_px": errors["jitter"]} if np.isfinite(errors["jitter"]) else {}
    return figures
