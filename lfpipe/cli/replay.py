"""`lfpipe replay`: runs a recorded sequence through the real stages and compares the results with a
reference.
"""

import contextlib
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from lfpipe.capture.spec import parse_source
from lfpipe.cli.options import OVERWRITE, PATH, with_settings
from lfpipe.cli.scene import opened
from lfpipe.cli.terminal import print_result, say
from lfpipe.errors import UserError
from lfpipe.files.output import check_output, check_outside
from lfpipe.host.files import is_dir
from lfpipe.replays import run
from lfpipe.replays.compare import Comparison, cases_of, check_reference, compare
from lfpipe.replays.report import (
    STEADY,
    Report,
    about_scene,
    about_sequence,
    read_report,
    write_junit,
)
from lfpipe.sequence.folder import open_sequence

PACES = ("step", "max", "recorded")
Cases = list[tuple[str, list[str]]]


@click.command()
@click.argument("path", type=PATH, metavar="SEQ")
@click.option(
    "--scene",
    type=PATH,
    metavar="S",
    help="Light field.  [default: the demo]",
)
@click.option(
    "--pace",
    default="step",
    show_default=True,
    metavar="step|max|recorded|HZ",
    help="Pace of the frames.",
)
@click.option(
    "--out", type=PATH, metavar="DIR", help="Folder for report.json, trace.jsonl and pictures."
)
@click.option(
    "--expect",
    type=PATH,
    metavar="REF",
    help="Compare with this folder, written by --out or --update.",
)
@click.option(
    "--update", is_flag=True, help="Write the reference of --expect instead of comparing."
)
@click.option("--junit", type=PATH, metavar="FILE", help="Write the outcome as JUnit XML.")
@OVERWRITE
@with_settings
def replay(path: Path, junit: Path | None, overwrite: bool, **options: Any) -> int:
    """Run SEQ through the pipeline. Exit code 0: equal, 1: different, 2: invalid input."""
    began = time.monotonic()
    if junit is not None:
        inputs = filter(None, [path, *(options[name] for name in ("scene", "expect", "out"))])
        check_output(junit, inputs, overwrite, "--junit")

    def write_outcome(cases: Cases, error: str = "") -> None:
        if junit is not None:
            write_junit(junit, path.name, cases, error, time.monotonic() - began)

    write_outcome([], "it did not finish")  # before the run, because the run may be killed
    try:
        cases = _replayed(path, **options)
        write_outcome(cases)
    except BaseException as error:
        with contextlib.suppress(UserError):
            write_outcome(
                [],
                (
                    "interrupted"
                    if isinstance(error, KeyboardInterrupt)
                    else str(error) or type(error).__name__
                ),
            )
        if not isinstance(error, run.ReplayFailed):
            raise
        say(f"error: replay of {path}: {error}")
        return 1
    return int(any(failures for _, failures in cases))


def _replayed(
    path: Path,
    scene: Path | None,
    pace: str,
    out: Path | None,
    expect: Path | None,
    update: bool,
    sets: tuple[str, ...],
    config_file: str | None,
) -> Cases:
    """Replays, and compares with expect or updates it.

    Returns the parts of the comparison with their failures.
    """
    _check(pace, out, expect, update)
    for folder, label in ((out, "--out"), (expect if update else None, "--expect")):
        if folder is not None:
            check_outside(folder, [path, scene, None if folder is expect else expect], label)
    against, new = (None, expect) if update else (expect, None)
    if against is not None:
        if not is_dir(against):
            raise UserError(
                f"--expect {against}: no such reference", "the first time, add --update"
            )
        read_report(against)
    sequence = open_sequence(path)
    if not sequence.complete:
        say(
            f"{path} was cut off during recording: replaying its {len(sequence.packets)} whole"
            " frames"
        )
    config = run.replay_config(sequence, config_file, sets)
    compared = Comparison([], [])
    with contextlib.ExitStack() as held:
        if new is not None:
            run.check_out(new)
        folder = out or Path(held.enter_context(TemporaryDirectory(prefix="lfpipe-replay-")))
        run.check_out(folder)
        field = opened(scene, config)
        if against is not None:
            inputs = {"sequence": about_sequence(sequence), "scene": about_scene(field)}
            check_reference(against, inputs)
        run.clear_out(folder)
        kept = pace == "step" and (out is not None or expect is not None)
        _summary(run.replay(sequence, field, config, pace, folder, kept, say))
        if against is not None:
            compared = compare(against, folder, keeps=out is not None)
        if new is not None:
            run.update_reference(new, folder)
            say(f"reference written to {new}")
    if against is None:
        return []
    for line in (*compared.notes, *(f"differs: {one}" for one in compared.differences)):
        print_result(line)
    if not compared.differences:
        print_result(f"matches {against}")
    elif out is None:
        say("use --out DIR to keep the pictures that differ")
    sys.stdout.flush()  # detects a closed pipe here, while it still counts as a failure
    return cases_of(compared.differences)


def _check(pace: str, out: Path | None, expect: Path | None, update: bool) -> None:
    """Raises UserError for options that exclude each other."""
    try:
        parse_source(f"file:sequence?pace={'max' if pace == 'step' else pace}")
    except UserError:
        remedy = (
            "use step, the fastest that gives the same results every time, max to play without"
            " waiting, or 30 to play at 30 Hz"
        )
        raise UserError(f"--pace {pace}: not {', '.join(PACES)} or a rate in Hz", remedy) from None
    if update and expect is None:
        raise UserError("--update needs a reference", "name it with --expect REF")
    if expect is not None and out is not None and os.path.realpath(expect) == os.path.realpath(out):
        raise UserError(
            f"--out and --expect are both {out}", "use two folders; --update writes the reference"
        )
    if expect is not None and pace not in STEADY:
        raise UserError(
            f"--expect with --pace {pace}: results depend on the clock",
            "compare with --pace step or max",
        )


def _summary(report: Report) -> None:
    counts = report["counts"]
    latency = report["latency"]["end_to_end"]
    dropped = sum(counts["dropped"].values())
    name = report["sequence"]["name"]
    print_result(
        f"{name}: {counts['frames']} frames, {counts['faces']} with a face, {counts['composed']}"
        " composed"
    )
    print_result(
        f"{report['rate_hz']:.1f} frames/s, {dropped} dropped, read to shown p50"
        f" {latency.get('p50_ms', 0):.2f} ms"
    )
    for name, error in (report["truth_error"] or {}).items():
        if error:
            print_result(
                f"eyes {name}: {error['rms_px']:.2f} px rms error, {error['max_px']:.2f} px at most"
            )
    for name, digest in (report["digests"] or {}).items():
        print_result(f"{name:<9} {digest[:16]}")  # the whole is in report.json
    sys.stdout.flush()
