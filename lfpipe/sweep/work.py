"""Measures a cell, in a child process of its own: a crash, a leak or a hang ends that process and nothing else."""

import math
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from lfpipe.bench.results import STATES, read
from lfpipe.errors import UserError, plain
from lfpipe.host.files import exists
from lfpipe.replays.report import read_report
from lfpipe.sweep.plan import QUALITY, REPLAY, TABLE, TRUTH, Cell
from lfpipe.sweep.results import DIED, DIFFERS, FAILED, LEFT_OUT, OK, Order, Outcome

REASON_CHARS = 2000
# A command ends with the worker that started it; otherwise the stages of its session would continue.
COMMAND = (
    "import runpy, sys; from lfpipe.host.processes import end_with_parent; sys.argv[0] = 'lfpipe';"
    " end_with_parent(int(sys.argv.pop(1))) and runpy.run_module('lfpipe', run_name='__main__')"
)
Measured = tuple[str, str, dict[str, Any]]  # state, reason, figures


def measure_cell(cell: Cell, order: Order) -> Outcome:
    """The outcome of a cell, measured on this host. A failed cell raises nothing."""
    began_s, figures = time.time(), dict[str, Any]()
    try:
        with tempfile.TemporaryDirectory(prefix="lfpipe-sweep-", ignore_cleanup_errors=True) as work:
            measure = _replay if cell.subject in (REPLAY, TRUTH) else _bench
            state, reason, figures = measure(cell, order, Path(work))
    except subprocess.TimeoutExpired:
        state, reason = FAILED, f"stopped after {order.limit_s:g} s; --limit gives more"
    except subprocess.CalledProcessError as error:
        state, signal = DIED, -error.returncode
        reason = f"its process was ended by signal {signal}" + ", perhaps out of memory" * (signal == 9)
    except UserError as error:
        state, reason = FAILED, str(error)
    except Exception as error:  # one cell's mistake must not end the sweep
        state, reason = FAILED, f"{type(error).__name__}: {error}"
    numbers = {name: value for name, value in figures.items() if isinstance(value, str) or math.isfinite(value)}
    return Outcome(cell, state, plain(reason, REASON_CHARS), numbers, round(time.time() - began_s, 4), platform.node(), began_s)


def _run(cell: Cell, order: Order, *words: str) -> tuple[int, str, str]:
    """Runs `lfpipe WORDS` with the settings of a cell, which ends with this process.

    Returns exit code, output, and the reason of a failure.
    Raises CalledProcessError if a signal ends it, and TimeoutExpired after the limit.
    """
    command = [sys.executable, "-c", COMMAND, str(os.getpid()), *words, *(f"--set={text}" for text in cell.sets)]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False, timeout=order.limit_s
    )
    if done.returncode < 0:
        raise subprocess.CalledProcessError(done.returncode, words)
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    first = next((k for k, line in enumerate(lines) if line.startswith("error: ")), max(0, len(lines) - 3))
    return done.returncode, done.stdout, "\n".join(lines[first:]).removeprefix("error: ") or f"exit code {done.returncode}"


def _replay(cell: Cell, order: Order, work: Path) -> Measured:
    words = ["replay", cell.sequence, "--out", str(work / "out"), *(["--scene", cell.scene] if cell.scene else [])]
    if cell.subject == TRUTH:
        words += ["--pace", "max"]
    elif order.reference:
        words += ["--expect", order.reference, *(["--update"] if order.update else [])]
    code, out, why = _run(cell, order, *words)
    differs = [line for line in out.splitlines() if line.startswith("differs: ")]
    if code and not (code == 1 and differs):
        return FAILED, why, {}
    report = read_report(work / "out")
    errors = {
        f"truth.{name}.{figure}": float(value)
        for name, table in (report["truth_error"] or {}).items()
        for figure, value in (table or {}).items()
        if isinstance(value, int | float)
    }
    if cell.subject == TRUTH:
        return (OK, "", errors) if errors else (LEFT_OUT, "the sequence has no truth", {})
    counts = {name: float(report["counts"][name]) for name in ("frames", "faces", "composed")}
    digests = {f"digest.{name}": str(value) for name, value in (report["digests"] or {}).items()}
    return DIFFERS if differs else OK, "\n".join(differs), {**counts, **errors, **digests}


def _bench(cell: Cell, order: Order, work: Path) -> Measured:
    table = cell.subject in (QUALITY, TABLE)
    if table:
        words = ["table", cell.scene, *(word for name, value in cell.options for word in (f"--{name}", value))]
        words += ["--untimed"] * (cell.subject == QUALITY)
    else:
        words = [cell.subject, "--quick", *(["--scene", cell.scene] if cell.scene else [])]
        words += ["--sequence", cell.sequence] if cell.sequence else []
    code, _, why = _run(cell, order, "bench", *words, "--out", str(work))
    if code and not (table and code == 1 and exists(work / "results.json")):  # 1: a scene was left out
        return FAILED, why, {}
    results = read(work)[TABLE if table else cell.subject]
    figures = {
        f"{row.curve}.{key}" if table else f"{row.name}: {key}": one.value
        for row in results.rows
        for key, one in row.values.items()
    }
    if states := [value.state for *_, value in results.judged() if not value.only]:
        figures |= {f"cells {state}": float(states.count(state)) for state in STATES}
    if results.failures:
        return FAILED, "; ".join(f"{one}: {reason}" for one, reason in results.failures.items()), figures
    return (OK, "", figures) if figures else (LEFT_OUT, "; ".join(results.left_out) or "nothing to measure", {})
