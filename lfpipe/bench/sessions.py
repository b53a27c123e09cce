"""Runs whole sessions, and the paper's loop, in separate processes; returns their traces and CPU time."""

import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import attrs
import cv2
import psutil

from lfpipe.bench.anaglyph import view_bgr
from lfpipe.bench.paper_loop import Loop
from lfpipe.host.files import exists
from lfpipe.scene.lightfield import LightField

STEADY_S = 1.0  # after the first picture every stage has started and found the face
POLL_S, START_S = 0.05, 90.0
PART_S = 0.5  # of a run: differences between its parts are its noise


@attrs.frozen
class SessionRun:
    """rows: of the trace. cpu_ms_s: CPU of all processes in each PART_S without the start, in ms per second. first_s: from the
    start of the process to its first picture."""

    rows: list[dict[str, Any]]
    cpu_ms_s: list[float]
    first_s: float


def process_tree(pid: int) -> list[int]:
    """pid and all its living descendants."""
    return [pid, *(child.pid for child in psutil.Process(pid).children(recursive=True))]


def cpu_ns(pids: Sequence[int]) -> int:
    """CPU time of the processes so far, by their own clocks; a process that has ended counts 0."""
    total = 0
    for pid in pids:
        try:
            total += time.clock_gettime_ns((~pid << 3) | 2)  # clock_getcpuclockid(3)
        except OSError:
            continue
    return total


def cpu_parts(pids: Sequence[int], seconds: float) -> list[float]:
    """CPU of the processes in ms per second, for each PART_S of the next seconds."""
    end = time.monotonic() + seconds
    marks = [(time.monotonic_ns(), cpu_ns(pids))]
    while time.monotonic() + PART_S <= end:
        time.sleep(PART_S)
        marks.append((time.monotonic_ns(), cpu_ns(pids)))
    time.sleep(max(0.0, end - time.monotonic()))
    return [1e3 * (used1 - used0) / (t1 - t0) for (t0, used0), (t1, used1) in itertools.pairwise(marks)]


def read_trace(trace: Path) -> list[dict[str, Any]]:
    """The complete lines of a trace."""
    text = trace.read_text() if exists(trace) else ""
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


def parts(rows: Sequence[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Rows of a trace by the PART_S in which they were shown, without an incomplete last part."""
    if not rows:
        return []
    first_ns, last_ns = rows[0]["t_presented_ns"], rows[-1]["t_presented_ns"]
    found: dict[int, list[dict[str, Any]]] = {}
    for row in rows:
        part = int((row["t_presented_ns"] - first_ns) / (PART_S * 1e9))
        if first_ns + (part + 1) * PART_S * 1e9 <= last_ns:
            found.setdefault(part, []).append(row)
    return list(found.values())


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
            cpu = cpu_parts(process_tree(process.pid), max(seconds - STEADY_S, 2 * PART_S))
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=30)
        finally:
            if process.poll() is None:
                process.kill()
                process.communicate()
        if process.returncode:
            raise RuntimeError(f"`lfpipe up` exited with {process.returncode}: {err.strip()[-300:]}")
        rows = read_trace(trace)
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
        rows = read_trace(loop.trace)
    if not rows:
        raise RuntimeError("the loop found no face")
    steady = [row for row in rows if row["t_presented_ns"] > rows[0]["t_presented_ns"] + STEADY_S * 1e9]
    ends = [part[-1] for part in parts(steady)]
    cpu = [1e3 * (b["cpu_ns"] - a["cpu_ns"]) / (b["t_presented_ns"] - a["t_presented_ns"]) for a, b in itertools.pairwise(ends)]
    return SessionRun(rows, cpu, (rows[0]["t_presented_ns"] - started_ns) / 1e9)


def write_views(field: LightField, folder: Path) -> Path:
    """Writes the views as PNG in row-major order for the loop, unless they exist."""
    count = field.rows * field.cols
    if len(list(folder.glob("*.png"))) != count:
        folder.mkdir(parents=True, exist_ok=True)
        for index in range(count):
            picture = view_bgr(field, *divmod(index, field.cols))
            cv2.imwrite(str(folder / f"view_{index:04d}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return folder
