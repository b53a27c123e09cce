"""Measures a cell on a worker, in a child process of its own: a crash, a leak or a hang ends that process and nothing else."""

import contextlib
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs

from lfpipe.bench.results import figures_of
from lfpipe.errors import UserError, plain
from lfpipe.host.files import exists, user_id
from lfpipe.replays.report import read_report
from lfpipe.supervisor import run_lock
from lfpipe.sweep.cell import DIED, DIFFERS, FAILED, LEFT_OUT, OK, QUALITY, REPLAY, TABLE, TRUTH, Cell, Outcome
from lfpipe.transport.session import base_dir

REASON_CHARS = 2000
TOPIC = "lfpipe"  # of the messages to the sweep
POLL_S, PATIENCE_S = 0.2, 5.0  # of the lock of timed cells; a shorter wait is not reported
# A command ends with the worker that started it; otherwise the stages of its session would continue.
COMMAND = (
    "import runpy, sys; from lfpipe.host.processes import end_with_parent; sys.argv[0] = 'lfpipe';"
    " end_with_parent(int(sys.argv.pop(1))) and runpy.run_module('lfpipe', run_name='__main__')"
)
Figures = dict[str, Any]


@attrs.frozen
class Order:
    """How to measure a cell. reference: folder to compare a replay with, "" for none; update: write it instead."""

    limit_s: float
    reference: str = ""
    update: bool = False


@contextlib.contextmanager
def alone(host: str, limit_s: float, say: Callable[[str], None]) -> Iterator[None]:
    """Waits until no other timed cell of this user runs on this host, and reports whom it waits for.

    The lock is in a 0700 directory of the user. host: its address, because containers may share it. Raises UserError after
    limit_s, or if the directory is not the user's own.
    """
    path = base_dir() / f"lfpipe-sweep-{user_id()}" / f"{re.sub(r'[^0-9A-Za-z.-]', '_', host)}.lock"
    began, reported = time.monotonic(), False
    try:
        while (lock := run_lock.take(path, make=True)) is None:
            waited_s = time.monotonic() - began
            if waited_s > limit_s:
                what = f"timed cells wait for {_holder(path)} for more than {limit_s:g} s"
                raise UserError(what, "end that process, or give more time with --limit")
            if waited_s > PATIENCE_S and not reported:
                reported = True
                say(f"waits for the timed cell of {_holder(path)}")
            time.sleep(POLL_S)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}", "remove it") from None
    try:
        path.with_suffix(".pid").unlink(missing_ok=True)
        with path.with_suffix(".pid").open("x") as file:  # "x" follows no link
            file.write(str(os.getpid()))
        yield
    finally:
        lock.release()


def _holder(path: Path) -> str:
    try:
        return f"process {int(path.with_suffix('.pid').read_text())}"
    except (OSError, ValueError):
        return f"the holder of {path}"


def measure_cell(cell: Cell, order: Order) -> Outcome:
    """On a Dask worker: the outcome of a cell. A failed cell raises nothing."""
    from distributed import get_worker

    worker = get_worker()
    host = str(worker.address).split("://")[-1].rsplit(":", 1)[0]
    return outcome_of(cell, order, host, lambda what: worker.log_event(TOPIC, {"key": cell.key, "text": what, "host": host}))


def outcome_of(cell: Cell, order: Order, host: str, say: Callable[[str], None]) -> Outcome:
    """The outcome of a cell. say: receives "" when the cell begins, and whom it waits for."""
    began_s, start = time.time(), time.perf_counter()
    figures: Figures = {}
    try:
        with alone(host, order.limit_s, say) if cell.timed else contextlib.nullcontext():
            say("")
            began_s, start = time.time(), time.perf_counter()
            with tempfile.TemporaryDirectory(prefix="lfpipe-sweep-", ignore_cleanup_errors=True) as work:
                subject = {QUALITY: _table, TABLE: _table, REPLAY: _replay, TRUTH: _replay}.get(cell.subject, _bench)
                state, reason, figures = subject(cell, order, Path(work))
    except subprocess.TimeoutExpired:
        state, reason = FAILED, f"stopped after {order.limit_s:g} s; --limit gives more"
    except _Died as error:
        state, reason = DIED, str(error)
    except UserError as error:
        state, reason = FAILED, str(error)
    except Exception as error:  # one cell's mistake must not end the sweep
        state, reason = FAILED, f"{type(error).__name__}: {error}"
    numbers = {name: value for name, value in figures.items() if isinstance(value, str) or math.isfinite(value)}
    return Outcome(cell, state, plain(reason, REASON_CHARS), numbers, round(time.perf_counter() - start, 4), host, began_s)


class _Died(Exception):
    """The process of a cell was ended by a signal."""


def _command(order: Order, *words: str) -> tuple[int, str, str]:
    """Runs `lfpipe WORDS`, which ends with this process. Returns exit code, output and errors.

    Raises _Died, and subprocess.TimeoutExpired after the limit.
    """
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, str(os.getpid()), *words], capture_output=True, text=True, errors="replace", check=False,
        stdin=subprocess.DEVNULL, timeout=order.limit_s,
    )  # fmt: skip
    if done.returncode < 0:
        raise _Died(f"its process was ended by signal {-done.returncode}" + ", perhaps out of memory" * (done.returncode == -9))
    return done.returncode, done.stdout, done.stderr


def _failure(code: int, err: str) -> str:
    lines = [line for line in err.splitlines() if line.strip()]
    first = next((k for k, line in enumerate(lines) if line.startswith("error: ")), max(0, len(lines) - 3))
    return "\n".join(lines[first:]).removeprefix("error: ") or f"exit code {code}"


def _sets(cell: Cell) -> list[str]:
    return [word for text in cell.sets for word in ("--set", text)]


def _table(cell: Cell, order: Order, work: Path) -> tuple[str, str, Figures]:
    options = [word for name, value in cell.options for word in (f"--{name}", value)]
    timed = cell.subject == TABLE
    words = ["bench", "table", cell.scene, *options, "--out", str(work), *([] if timed else ["--untimed"]), *_sets(cell)]
    code, _, err = _command(order, *words)
    rows = [json.loads(line) for line in file.read_text().splitlines()] if exists(file := work / "table.jsonl") else []
    if not rows:
        return FAILED, _failure(code, err), {}
    if reasons := [row["left_out"] for row in rows if row["left_out"]]:
        return LEFT_OUT, reasons[0], {}
    names = ("psnr_db", "ssim", "worst_db", *(("ms", "mb") if timed else ()))
    return OK, "", {f"{row['method']}.{name}": row[name] for row in rows for name in names}


def _replay(cell: Cell, order: Order, work: Path) -> tuple[str, str, Figures]:
    words = ["replay", cell.sequence, "--out", str(work / "out"), *(["--scene", cell.scene] if cell.scene else []), *_sets(cell)]
    if cell.subject == TRUTH:
        words += ["--pace", "max"]
    elif order.reference:
        words += ["--expect", order.reference, *(["--update"] if order.update else [])]
    code, out, err = _command(order, *words)
    differs = [line for line in out.splitlines() if line.startswith("differs: ")]
    if code and not (code == 1 and differs):
        return FAILED, _failure(code, err), {}
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


def _bench(cell: Cell, order: Order, work: Path) -> tuple[str, str, Figures]:
    inputs = [word for name in ("scene", "sequence") if getattr(cell, name) for word in (f"--{name}", getattr(cell, name))]
    code, _, err = _command(order, "bench", cell.subject, "--quick", "--out", str(work), *inputs, *_sets(cell))
    if code:
        return FAILED, _failure(code, err), {}
    figures, failures, omissions = figures_of(work, cell.subject)
    if failures:
        return FAILED, "; ".join(failures), figures
    return (OK, "", figures) if figures else (LEFT_OUT, "; ".join(omissions) or "nothing to measure", {})
