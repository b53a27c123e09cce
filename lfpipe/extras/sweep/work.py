"""Measures a cell, in a child process of its own: a crash, a leak or a hang ends that process and
nothing else.
"""

import json
import math
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import attrs

from lfpipe.bench.results import STATES, read
from lfpipe.errors import UserError, plain, quoted
from lfpipe.extras.sweep.plan import QUALITY, REPLAY, TABLE, TRUTH, Cell
from lfpipe.extras.sweep.results import DIED, DIFFERS, FAILED, LEFT_OUT, OK, Outcome
from lfpipe.files.safe_files import json_fields, read_text, write_output
from lfpipe.host.files import exists, is_dir
from lfpipe.replays.run import REPORT, read_report

REFERENCE = "metrics.json"  # in the reference of a cell without pictures
AGAIN = "copy the whole folder again, or rewrite it with --update"
CLOSE = 1e-3  # relative tolerance of metrics, for rounding on other processors
# A command ends with the worker that started it;
# otherwise the stages of its session would continue.
COMMAND = (
    "import runpy, sys; from lfpipe.host.worker import end_with_thread_of; sys.argv[0] = 'lfpipe';"
    " end_with_thread_of(int(sys.argv.pop(1))) and runpy.run_module('lfpipe', run_name='__main__')"
)
Measured = tuple[str, str, dict[str, Any]]  # state, reason, metrics


@attrs.frozen
class SweepOptions:
    """How to measure cells."""

    limit_s: float
    references: str = ""
    """Folder with a folder for each replay and quality cell; "" compares nothing."""
    update: bool = False
    """References are written instead."""

    def reference(self, cell: Cell) -> Path | None:
        """Where the reference of a cell is; None for a subject without."""
        return (
            Path(self.references, cell.folder)
            if self.references and cell.subject in (REPLAY, QUALITY)
            else None
        )


def check_references(options: SweepOptions, cells: Iterable[Cell]) -> None:
    """Raises UserError if the folder of references is missing, or, with update, if it is somebody's
    own folder or a cell would write into one.
    """
    folder = Path(options.references)
    if not options.update:
        if not is_dir(folder):
            raise UserError(f"--expect {folder}: no such folder", "the first time, add --update")
        return
    places = [place for cell in cells if (place := options.reference(cell))]
    others = [place for place in places if os.path.lexists(place) and not _is_reference(place)]
    entries = list(folder.glob("[!.]*"))
    if entries and not any(map(_is_reference, entries)):
        others.append(min(entries))
    if others:
        raise UserError(
            f"--expect {folder}: {quoted(others[0].name)} there is not a reference of a sweep",
            "name a new folder",
        )


def _is_reference(place: Path) -> bool:
    """Whether a folder is one, of a cell of any subject."""
    return is_dir(place) and any(exists(place / name) for name in (REFERENCE, REPORT))


def measure_cell(cell: Cell, options: SweepOptions) -> Outcome:
    """The outcome of a cell, measured on this host. A failed cell raises nothing."""
    began_s = time.time()
    started_s = time.monotonic()
    metrics = dict[str, Any]()
    try:
        with TemporaryDirectory(prefix="lfpipe-sweep-") as work:
            measure = _replay if cell.subject in (REPLAY, TRUTH) else _bench
            state, reason, metrics = measure(cell, options, Path(work))
        if state == OK and (place := options.reference(cell)):
            state, reason = _compared(cell, metrics, place, options.update)
    except subprocess.TimeoutExpired:
        state = FAILED
        reason = f"stopped after {options.limit_s:g} s; --limit gives more"
    except subprocess.CalledProcessError as error:
        state = DIED
        signal = -error.returncode
        reason = f"its process was ended by signal {signal}" + ", perhaps out of memory" * (
            signal == 9
        )
    except Exception as error:  # an error in one cell must not end the sweep
        state = FAILED
        reason = str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
    numbers = {
        name: value
        for name, value in metrics.items()
        if isinstance(value, str) or math.isfinite(value)
    }
    return Outcome(
        cell,
        state,
        plain(reason, 2000),  # the end of a traceback
        numbers,
        round(time.monotonic() - started_s, 4),
        platform.node(),
        began_s,
    )


def _run(cell: Cell, options: SweepOptions, *words: str) -> tuple[int, str, str]:
    """Runs `lfpipe WORDS` with the settings of a cell, which ends with this process.

    Returns exit code, output, and the reason of a failure.
    Raises CalledProcessError if a signal ends it, and TimeoutExpired after the limit.
    """
    command = [
        sys.executable,
        "-P",
        "-c",
        COMMAND,
        str(os.getpid()),
        *words,
        *(f"--set={text}" for text in cell.sets),
    ]
    done = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
        timeout=options.limit_s,
    )
    if done.returncode < 0:
        raise subprocess.CalledProcessError(done.returncode, words)
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    first = next(
        (k for k, line in enumerate(lines) if line.startswith("error: ")), max(0, len(lines) - 3)
    )
    return (
        done.returncode,
        done.stdout,
        "\n".join(lines[first:]).removeprefix("error: ") or f"exit code {done.returncode}",
    )


def _replay(cell: Cell, options: SweepOptions, work: Path) -> Measured:
    words = [
        "replay",
        cell.sequence,
        "--out",
        str(work / "out"),
        *(["--scene", cell.scene] if cell.scene else []),
    ]
    if cell.subject == TRUTH:
        words += ["--pace", "max"]
    elif (place := options.reference(cell)) and (options.update or is_dir(place)):
        place.parent.mkdir(parents=True, exist_ok=True)
        words += ["--expect", str(place), *(["--update"] if options.update else [])]
    code, out, why = _run(cell, options, *words)
    differs = [line for line in out.splitlines() if line.startswith("differs: ")]
    if code and not (code == 1 and differs):
        return FAILED, why, {}
    report = read_report(work / "out")
    tables = {name: table or {} for name, table in (report["truth_error"] or {}).items()}
    errors = {
        f"truth.{name}.{metric}": value
        for name, table in tables.items()
        for metric, value in table.items()
    }
    if cell.subject == TRUTH:
        return (OK, "", errors) if errors else (LEFT_OUT, "the sequence has no truth", {})
    counts = {name: report["counts"][name] for name in ("frames", "faces", "composed")}
    digests = {f"digest.{name}": value for name, value in (report["digests"] or {}).items()}
    return DIFFERS if differs else OK, "\n".join(differs), {**counts, **errors, **digests}


def _bench(cell: Cell, options: SweepOptions, work: Path) -> Measured:
    table = cell.subject in (QUALITY, TABLE)
    if table:
        words = [
            "table",
            cell.scene,
            *(f"--{option}" for option in cell.options),
            *["--untimed"] * (cell.subject == QUALITY),
        ]
    else:
        words = [cell.subject, "--quick", *(["--scene", cell.scene] if cell.scene else [])]
        words += ["--sequence", cell.sequence] if cell.sequence else []
    code, _, why = _run(cell, options, "bench", *words, "--out", str(work))
    # 1: a scene was left out
    if code and not (table and code == 1 and exists(work / "results.json")):
        return FAILED, why, {}
    results = read(work)[TABLE if table else cell.subject]
    named = [(f"{row.curve}." if table else f"{row.name}: ", row.values) for row in results.rows]
    metrics = {name + key: one.value for name, values in named for key, one in values.items()}
    if states := [value.state for *_, value in results.judged() if not value.only]:
        metrics |= {f"cells {state}": float(states.count(state)) for state in STATES}
    if results.failures:
        return (
            FAILED,
            "; ".join(f"{one}: {reason}" for one, reason in results.failures.items()),
            metrics,
        )
    return (
        (OK, "", metrics)
        if metrics
        else (LEFT_OUT, "; ".join(results.left_out) or "nothing to measure", {})
    )


def _compared(cell: Cell, metrics: dict[str, Any], place: Path, update: bool) -> tuple[str, str]:
    """State and reason by its reference, which is written with update; `lfpipe replay` compares and
    writes its own.
    """
    if not update and not is_dir(place):
        return FAILED, f"no reference {place.name}: write it with --update"
    if cell.subject == REPLAY:
        return OK, ""
    if update:
        place.mkdir(parents=True, exist_ok=True)
        write_output(place / REFERENCE, json.dumps(metrics, indent=1).encode(), label="--expect")
        return OK, ""
    path = place / REFERENCE
    was = json_fields(read_text(path, str(path), AGAIN), str(path), AGAIN)
    wrong = [
        f"{name}: {value} in the reference, now {metrics.get(name)}"
        for name in was.values
        if not math.isclose(
            value := was.number(name, -math.inf, math.inf),
            float(metrics.get(name, "nan")),
            rel_tol=0.0,
            abs_tol=CLOSE * abs(value),
        )
    ]
    return (DIFFERS, "\n".join(wrong)) if wrong else (OK, "")
