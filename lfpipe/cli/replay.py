"""`lfpipe replay`: a recorded sequence through the real stages, and the comparison with a reference."""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from lfpipe.cli.options import with_config

PATH = click.Path(path_type=Path)
REFERENCE = ("report.json", "trace.jsonl", "pictures")  # what a comparison reads


def say(text: str) -> None:
    """A line for the person, on stderr: stdout is for results."""
    click.echo(text, err=True)


@click.command()
@click.argument("path", type=PATH, metavar="SEQ")
@click.option("--scene", type=PATH, metavar="S", help="The light field; the demo's without it.")
@click.option("--pace", default="step", show_default=True, metavar="step|max|recorded|HZ", help="How frames follow each other.")
@click.option("--out", type=PATH, metavar="DIR", help="Where report.json, trace.jsonl and pictures go.")
@click.option("--expect", type=PATH, metavar="REF", help="Compare with this folder, which --out or --update wrote.")
@click.option("--update", is_flag=True, help="Write the reference of --expect instead of comparing with it.")
@click.option("--budget", "budget_file", type=PATH, metavar="FILE", help="Fail where a figure leaves its budget.")
@click.option("--junit", type=PATH, metavar="FILE", help="The outcome as JUnit XML.")
@with_config
def replay(
    path: Path,
    scene: Path | None,
    pace: str,
    out: Path | None,
    expect: Path | None,
    update: bool,
    budget_file: Path | None,
    junit: Path | None,
    sets: tuple[str, ...],
    config_file: str | None,
) -> int:
    """Run SEQ through the pipeline; exit code 0: as expected, 1: it differs or is over budget, 2: bad input."""
    from lfpipe.cli.scene_opening import open_with_progress
    from lfpipe.replay import run
    from lfpipe.replay.budgets import broken, read_budgets
    from lfpipe.replay.compare import Comparison, check_reference, compare
    from lfpipe.replay.junit import write_junit
    from lfpipe.replay.report import about_scene, about_sequence, read_report
    from lfpipe.sequence.folder import open_sequence

    began = time.monotonic()
    _check(pace, out, expect, update)
    sequence = open_sequence(path)
    if not sequence.complete:
        say(f"{path} was cut off while it was recorded: {len(sequence.packets)} whole frames are replayed")
    config = run.replay_config(sequence, config_file, sets)
    budgets = read_budgets(budget_file) if budget_file else None
    if junit is not None:
        write_junit(junit, path.name, False, [], None, 0.0)  # says now, and not after the run, that it cannot be written
    if expect is not None and not update:
        read_report(expect)
    with _folder(out) as folder:
        run.clear_out(folder)
        field = open_with_progress(scene, config.scene)
        if expect is not None and not update:
            check_reference(expect, {"sequence": about_sequence(sequence), "scene": about_scene(field)})
        try:
            kept = pace == "step" and (out is not None or expect is not None)
            report = run.replay(sequence, field, config, pace, folder, kept, say)
        except run.ReplayFailed as error:
            say(f"error: replay of {path}: {error}")
            return 1
        _summary(report)
        compared = Comparison([], [])
        if expect is not None and update:
            _update(expect, folder)
        elif expect is not None:
            compared = compare(expect, folder)
            if compared.differences and out is None:
                _keep_difference(folder)
        over = broken(budgets, report, read_report(expect) if expect and not update else None) if budgets else None
    for note in compared.notes:
        click.echo(note)
    for difference in compared.differences:
        click.echo(f"differs: {difference}")
    for line in over or ():
        click.echo(f"over budget: {line}")
    if junit is not None:
        against = expect is not None and not update
        write_junit(junit, path.name, against, compared.differences, over, time.monotonic() - began)
    if expect is not None and not update and not compared.differences:
        click.echo(f"as in {expect}")
    return 1 if compared.differences or over else 0


def _check(pace: str, out: Path | None, expect: Path | None, update: bool) -> None:
    """What of the options does not go together."""
    from lfpipe.capture.spec import parse_source
    from lfpipe.errors import UserError
    from lfpipe.replay.run import STEADY

    if pace != "step":
        parse_source(f"file:sequence?pace={pace}")
    if update and expect is None:
        raise UserError("--update: which reference?", "name it with --expect REF")
    if expect is not None and out is not None and expect.resolve() == out.resolve():
        raise UserError(f"--out and --expect are both {out}", "two folders; --update writes the reference")
    if expect is not None and pace not in STEADY:
        raise UserError(f"--expect with --pace {pace}: results then depend on the clock", "compare with --pace step or max")


@contextlib.contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    if out is not None:
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="lfpipe-replay-") as folder:
        yield Path(folder)


def _keep_difference(folder: Path) -> None:
    """Without --out the pictures that show a difference go to the current directory."""
    if (folder / "difference").is_dir():
        shutil.copytree(folder / "difference", Path("difference"), dirs_exist_ok=True)
        say("pictures of the difference are in difference/")


def _update(reference: Path, folder: Path) -> None:
    from lfpipe.replay.run import clear_out

    clear_out(reference)
    for name in REFERENCE:
        if (folder / name).is_dir():
            shutil.copytree(folder / name, reference / name)
        else:
            shutil.copyfile(folder / name, reference / name)
    say(f"reference written to {reference}")


def _summary(report: dict[str, Any]) -> None:
    counts, latency = report["counts"], report["latency"]["end_to_end"]
    dropped = sum(counts["dropped"].values())
    name = report["sequence"]["name"]
    click.echo(f"{name}: {counts['frames']} frames, {counts['faces']} with a face, {counts['composed']} composed")
    click.echo(f"{report['rate_hz']:.1f} frames/s, {dropped} dropped, read to shown p50 {latency.get('p50_ms', 0):.2f} ms")
    for name, error in (report["truth_error"] or {}).items():
        if error:
            click.echo(f"eyes {name}: {error['rms_px']:.2f} px rms from the truth, {error['max_px']:.2f} at most")
    for name, digest in (report["digests"] or {}).items():
        click.echo(f"{name:<8} {digest}")
    sys.stdout.flush()
