"""Measures a cell on a worker. A user's mistake raises nothing here: it becomes the cell's reason."""

import contextlib
import io
import math
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs

from lfpipe import config
from lfpipe.bench.results import read as read_bench
from lfpipe.bench.subjects import SUBJECTS as BENCH_SUBJECTS
from lfpipe.bench.table import Protocol, measure_scene
from lfpipe.errors import UserError, plain
from lfpipe.host import file_lock
from lfpipe.host.paths import exists, is_file
from lfpipe.render.scoring import choose_method
from lfpipe.replay.report import read_report
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.pack import open_scene
from lfpipe.sweep.cell import DIFFERS, FAILED, LEFT_OUT, OK, QUALITY, REPLAY, TABLE, TRUTH, Cell, Outcome, outcome

REASON_CHARS = 2000
SENT_BYTES = 8 << 20  # folders up to this size are sent with their cells
# A command ends with the worker that started it; otherwise the stages of its session would continue.
COMMAND = (
    "import runpy, sys; from lfpipe.host.parent import end_with_parent; sys.argv[0] = 'lfpipe';"
    " end_with_parent(int(sys.argv.pop(1))) and runpy.run_module('lfpipe', run_name='__main__')"
)


@attrs.frozen
class Parcel:
    """A folder or file that a cell needs. digest: of its contents. tar: empty if only its path is sent."""

    path: str
    digest: str = ""
    tar: bytes = b""


def packed(path: str, digest: str, most_bytes: int = SENT_BYTES) -> Parcel:
    """The parcel of a path, with its contents if they are small. Raises OSError."""
    root = Path(path)
    files = [root] if is_file(root) else sorted(file for file in root.rglob("*") if is_file(file))
    if not path or sum(file.stat().st_size for file in files) > most_bytes:
        return Parcel(path)
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as tar:
        tar.add(root, arcname=root.name)
    return Parcel(path, digest, buffer.getvalue())


def unpacked(parcel: Parcel) -> str:
    """The path of a parcel on this host. A tar is unpacked once, into the cache. Raises OSError."""
    if not parcel.tar:
        return parcel.path
    place = cache_dir(config.load().scene) / "sent" / parcel.digest
    there = place / Path(parcel.path).name
    if not exists(there):
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place) as new, tarfile.open(fileobj=io.BytesIO(parcel.tar)) as tar:
            tar.extractall(new, filter="data")
            with contextlib.suppress(OSError):  # another worker was faster
                (Path(new) / there.name).replace(there)
    return str(there)


@contextlib.contextmanager
def alone(host: str) -> Iterator[None]:
    """Waits until no other timed cell runs on this host. host: its address, because containers may share /tmp."""
    name = f"lfpipe-quiet-{os.environ.get('USER', '')}-{re.sub(r'[^0-9A-Za-z.-]', '_', host)}.lock"
    with file_lock.waited_for(Path(tempfile.gettempdir()) / name):
        yield


def do_cell(cell: Cell, sequence: Parcel, scene: Parcel, reference: bytes, update: bool, host: str = "") -> tuple[Outcome, bytes]:
    """Measures a cell. reference: tar of the folder to compare a replay with. update: return such a tar instead.

    Returns the outcome and the tar, b"" if there is none.
    """
    host = host or _host()
    with alone(host) if cell.timed else contextlib.nullcontext():
        began, start = time.time(), time.perf_counter()
        new = b""
        try:
            here = attrs.evolve(cell, sequence=unpacked(sequence), scene=unpacked(scene))
            if cell.subject in (QUALITY, TABLE):
                state, reason, figures = _table(here)
            elif cell.subject in (REPLAY, TRUTH):
                state, reason, figures, new = _replay(here, reference, update)
            else:
                state, reason, figures = _bench(here)
        except UserError as error:
            state, reason, figures = FAILED, str(error), {}
        except Exception as error:  # one cell's mistake must not end the sweep
            state, reason, figures = FAILED, f"{type(error).__name__}: {error}", {}
        numbers = {name: value for name, value in figures.items() if isinstance(value, str) or math.isfinite(value)}
        took_s = round(time.perf_counter() - start, 4)
        text = plain(reason, REASON_CHARS)
        done = outcome(cell, state, text, figures=numbers, seconds=took_s, host=host, began_s=began)
    return done, new


def _host() -> str:
    """Address of the worker that runs this, without its port."""
    try:
        from distributed import get_worker

        return str(get_worker().address).split("://")[-1].rsplit(":", 1)[0]
    except (ImportError, ValueError):  # not on a worker
        return "here"


def _table(cell: Cell) -> tuple[str, str, dict[str, Any]]:
    import cv2

    cv2.setNumThreads(1)
    field = open_scene(cell.scene, config.load(None, cell.sets).scene, None, choose_method)
    options = dict(cell.options)
    protocol = Protocol(int(options["keep"]), options["crop"], int(options["border"]))
    timed = cell.subject == TABLE
    lines = list(measure_scene(field, field.name, protocol, (), lambda *_: None, timed))
    reasons = [line.left_out for line in lines if line.left_out]
    if reasons:
        return LEFT_OUT, reasons[0], {}
    names = ("psnr_db", "ssim", "worst_db", *(("ms", "mb") if timed else ()))
    return OK, "", {f"{line.method}.{name}": getattr(line, name) for line in lines for name in names}


def _command(*words: str) -> subprocess.CompletedProcess[str]:
    """Runs `lfpipe WORDS`; it ends with this process."""
    return subprocess.run(
        [sys.executable, "-c", COMMAND, str(os.getpid()), *words], capture_output=True, text=True, errors="replace", check=False,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip


def _failure(done: subprocess.CompletedProcess[str]) -> str:
    said = [line for line in done.stderr.splitlines() if line.strip()]
    first = next((k for k, line in enumerate(said) if line.startswith("error: ")), max(0, len(said) - 3))
    how = f"ended by signal {-done.returncode}" if done.returncode < 0 else f"exit code {done.returncode}"
    return "\n".join(said[first:]).removeprefix("error: ") or how


def _sets(cell: Cell) -> list[str]:
    return [word for each in cell.sets for word in ("--set", each)]


def _replay(cell: Cell, reference: bytes, update: bool) -> tuple[str, str, dict[str, Any], bytes]:
    with tempfile.TemporaryDirectory(prefix="lfpipe-sweep-", ignore_cleanup_errors=True) as work:
        out, expected, new = Path(work) / "out", Path(work) / "expected", Path(work) / "new"
        words = ["replay", cell.sequence, "--out", str(out), *(["--scene", cell.scene] if cell.scene else []), *_sets(cell)]
        if cell.subject == TRUTH:
            words += ["--pace", "max"]
        elif update:
            words += ["--expect", str(new), "--update"]
        elif reference:
            with tarfile.open(fileobj=io.BytesIO(reference)) as tar:
                tar.extractall(expected, filter="data")
            words += ["--expect", str(expected)]
        done = _command(*words)
        differs = [line for line in done.stdout.splitlines() if line.startswith(("differs: ", "over budget: "))]
        if done.returncode and not (done.returncode == 1 and differs):
            return FAILED, _failure(done), {}, b""
        report = read_report(out)
        errors = {
            f"truth.{name}.{figure}": float(value)
            for name, found in (report["truth_error"] or {}).items()
            for figure, value in (found or {}).items()
            if isinstance(value, int | float)
        }
        if cell.subject == TRUTH:
            return (OK, "", errors, b"") if errors else (LEFT_OUT, "the sequence has no truth", {}, b"")
        counts = {name: float(report["counts"][name]) for name in ("frames", "faces", "composed")}
        digests = {f"digest.{name}": str(value) for name, value in (report["digests"] or {}).items()}
        return DIFFERS if differs else OK, "\n".join(differs), {**counts, **errors, **digests}, _tar(new) if update else b""


def _tar(folder: Path) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as tar:
        for path in sorted(folder.iterdir()):
            tar.add(path, arcname=path.name)
    return buffer.getvalue()


def _bench(cell: Cell) -> tuple[str, str, dict[str, Any]]:
    with tempfile.TemporaryDirectory(prefix="lfpipe-sweep-", ignore_cleanup_errors=True) as work:
        given = [word for name in ("scene", "sequence") if getattr(cell, name) for word in (f"--{name}", getattr(cell, name))]
        done = _command("bench", cell.subject, "--quick", "--out", work, *given, *_sets(cell))
        if done.returncode:
            return FAILED, _failure(done), {}
        found, subject = read_bench(Path(work)).subjects[cell.subject], BENCH_SUBJECTS[cell.subject]
        measured = [(f"{name}: {of.key}", one.value(of)) for name, one in found.measured.items() for of in subject.figures]
        figures: dict[str, Any] = {name: float(f"{value:.6g}") for name, value in measured}
        cells = [each for table in found.tables for row in table.rows for each in row]
        for state in ("ok", "degraded", "failed"):
            if any(each.state for each in cells):
                figures[f"cells {state}"] = float(sum(each.state == state for each in cells))
        if found.omissions:
            return FAILED, "; ".join(f"{name}: {why}" for name, why in found.omissions.items()), figures
        if not figures and not cells:
            return LEFT_OUT, "; ".join(f"{each.what}: {each.why}" for each in found.skipped) or "nothing to measure", {}
        return OK, "", figures
