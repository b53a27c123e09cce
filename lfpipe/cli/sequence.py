"""`lfpipe record`, `replay` and `sequence`: records a camera; runs a recorded sequence through the
real stages and compares the results with a reference; inspects and converts sequences.
"""

import contextlib
import itertools
import json
import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import attrs
import click
import numpy as np

from lfpipe.capture.open_source import camera_name, camera_settings, check_source, clock_of
from lfpipe.capture.recordings import STAMP_ROUNDING_NS, Schedule, open_recording
from lfpipe.capture.spec import parse_source
from lfpipe.cli.scene import opened
from lfpipe.cli.sessions import exit_code
from lfpipe.cli.terminal import (
    CAMERA,
    DURATION,
    OVERWRITE,
    PATH,
    Group,
    Number,
    print_result,
    say,
    with_config,
    with_settings,
)
from lfpipe.config import Config, SessionOptions
from lfpipe.config.check import MAX_LISTED, with_measured_focal
from lfpipe.config.session_options import RecordedEyes
from lfpipe.errors import UserError, plain
from lfpipe.files.safe_files import check_output, check_outside, create_private, open_regular
from lfpipe.host.files import exists, is_dir
from lfpipe.host.worker import versions
from lfpipe.replays import run
from lfpipe.replays.compare import Comparison, cases_of, check_reference, compare
from lfpipe.replays.run import (
    STEADY,
    Report,
    about_scene,
    about_sequence,
    write_junit,
)
from lfpipe.sequence.folder import (
    check_out,
    check_sums,
    new_sequence,
    open_sequence,
    remove_empty,
)
from lfpipe.sequence.folder import cut as cut_sequence
from lfpipe.sequence.packets import TRUTH, encoded, read_truth, table_of
from lfpipe.supervisor.session import run_session
from lfpipe.transport.control import Session

SEQUENCES = click.argument("paths", type=PATH, metavar="SEQ...", nargs=-1, required=True)


@click.command()
@click.argument("out", type=PATH)
@CAMERA
@DURATION
@with_config
def record(out: Path, camera: str | None, duration_s: float | None, config: Config) -> int:
    """Record a camera to the new folder OUT, for `lfpipe replay`.

    Stop with Ctrl-C. See also `lfpipe ctl record`.
    """
    viewer = check_source(camera or config.camera.source, camera_settings(config))
    if isinstance(viewer, RecordedEyes):
        raise UserError(f"{viewer.source} is a recording already", "copy its folder")
    config = with_measured_focal(config, camera_name(viewer.source))
    check_out(out)
    viewer = attrs.evolve(viewer, tracked=False)
    options = SessionOptions(
        viewer=viewer,
        clock=clock_of(viewer.source),
        show=False,
        record=str(out.resolve()),
    )
    try:
        outcome = run_session(Session(f"record.{os.getpid()}"), config, options, say, duration_s)
    finally:
        remove_empty(out)
    if not exists(out) and outcome.failure is None:
        outcome.failure = f"{out}: no frame was recorded"
        outcome.remedy = "record for longer: the camera takes some seconds to start"
    return exit_code(outcome)


@click.group(cls=Group)
def sequence() -> None:
    """Inspect, cut and import recorded sequences."""


def _for_all(paths: tuple[Path, ...], look: Callable[[Path], None]) -> int:
    """Runs look on each path, even after an error; returns the exit code."""
    code = 0
    for path in paths:
        try:
            look(path)
        except UserError as error:
            if len(paths) == 1:
                raise
            say(f"error: {error}")
            code = 2
    return code


@sequence.command()
@SEQUENCES
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
def info(paths: tuple[Path, ...], as_json: bool) -> int:
    """Show the contents of each SEQ."""
    return _for_all(paths, lambda path: _info(path, as_json))


def _info(path: Path, as_json: bool) -> None:
    recorded = open_sequence(path, verify=False)
    about: dict[str, Any] = {
        "frames": len(recorded.packets),
        "lost": recorded.lost,
        "duration_s": round(recorded.duration_s, 6),
        "rate_hz": round(recorded.measured_hz, 4),
        "width_px": recorded.width_px,
        "height_px": recorded.height_px,
        "codecs": sorted(recorded.packets.codecs),
        "bytes": sum(packet.bytes for packet in recorded.packets),
        "complete": recorded.complete,
        "truth": exists(recorded.path / TRUTH),
        **{name: str(recorded.manifest.get(name, "")) for name in ("source", "created")},
        "versions": recorded.manifest.get("versions", {}),
    }
    if as_json:
        print_result(json.dumps(about))
        return
    print_result(path)
    about["versions"] = [f"{name} {version}" for name, version in about["versions"].items()]
    for name, value in about.items():
        print_result(
            f"  {name:<12}"
            f" {plain(', '.join(value) if isinstance(value, list) else str(value), 400)}"
        )


@sequence.command()
@SEQUENCES
def check(paths: tuple[Path, ...]) -> int:
    """Read each SEQ completely and verify checksums, frames, stamps and lines."""
    return _for_all(paths, _check)


def _check(path: Path) -> None:
    recorded = open_sequence(path, verify=False)
    read_frame = recorded.eyes if recorded.holds_eyes else recorded.frame
    checks: Iterable[Callable[[], object]] = itertools.chain(
        (partial(read_frame, seq) for seq in range(len(recorded.packets))),
        (partial(read_truth, path), partial(check_sums, recorded)),
    )
    errors: list[str] = []
    count = 0
    remedy = ""
    for check_one in checks:
        try:
            check_one()
        except UserError as error:  # whose traceback holds the whole frame
            count += 1
            errors += [error.message] * (count <= MAX_LISTED)
            remedy = remedy or error.remedy
    if errors:
        errors += [f"and {count - MAX_LISTED} more"] * (count > MAX_LISTED)
        raise UserError("\n  ".join(errors), remedy)
    state = (
        "complete"
        if recorded.complete
        else "cut off during recording, readable to its last whole frame"
    )
    print_result(f"{path}: {len(recorded.packets)} frames, all readable; {state}")


@sequence.command()
@click.argument("path", type=PATH, metavar="SEQ")
@click.argument("out", type=PATH)
@click.option(
    "--from",
    "begin_s",
    type=Number(min=0),
    default=0.0,
    metavar="S",
    help="Seconds after the first frame.",
)
@click.option("--to", "end_s", type=Number(min=0), metavar="S", help="Exclusive end, in seconds.")
def cut(path: Path, out: Path, begin_s: float, end_s: float | None) -> None:
    """Copy a part of SEQ to the new sequence OUT. Frames are copied byte for byte."""
    end_s = math.inf if end_s is None else end_s
    frames = cut_sequence(open_sequence(path, verify=False), out, begin_s, end_s)
    print_result(f"{out}: {frames} frames")


@sequence.command("import")
@click.argument("video", type=PATH)
@click.argument("out", type=PATH)
@click.option(
    "--truth",
    type=PATH,
    metavar="CSV",
    help="True eye positions, as tools/make_sequence.py writes them.",
)
def import_(video: Path, out: Path, truth: Path | None) -> None:
    """Create the sequence OUT from VIDEO. Motion JPEG frames are copied unchanged."""
    if truth is not None:
        table_of(truth)
    with contextlib.closing(open_recording(video)) as frames:
        (width_px, height_px), rate_hz = frames.info.size_px, frames.info.rate_hz
        if not rate_hz:
            raise UserError(f"{video}: has no frame rate", "give a video (avi, mkv, mp4, ...)")
        schedule = Schedule(rate_hz, 0 if frames.exact else STAMP_ROUNDING_NS)
        picture = np.empty((height_px, width_px, 3), np.uint8)
        with new_sequence(
            out, f"file:{video.name}", (width_px, height_px), rate_hz, versions=versions()
        ) as writer:
            while (frame := frames.read_into(writer.count, picture)) is not None:
                codec, packet = (
                    ("jpeg", frame.packet.tobytes())
                    if frame.packet is not None
                    else ("png", encoded(picture))
                )
                t_ns = schedule.due_ns(writer.count, frame.stamp_ns)
                writer.append(packet, codec, writer.count, 0, t_ns, t_ns)
            if truth is not None:
                with create_private(out / TRUTH) as file, open_regular(truth) as table:
                    shutil.copyfileobj(table, file)
    print_result(f"{out}: {writer.count} frames")


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
    _check_outputs(pace, out, expect, update)
    for folder, label in ((out, "--out"), (expect if update else None, "--expect")):
        if folder is not None:
            check_outside(folder, [path, scene, None if folder is expect else expect], label)
    against, new = (None, expect) if update else (expect, None)
    if against is not None and not is_dir(against):
        raise UserError(f"--expect {against}: no such reference", "the first time, add --update")
    sequence = open_sequence(path)
    if not sequence.complete:
        say(
            f"{path} was cut off during recording: replaying its {len(sequence.packets)} whole"
            " frames"
        )
    config = run.replay_config(sequence, config_file, sets)
    compared = Comparison([], [])
    with contextlib.ExitStack() as resources:
        if new is not None:
            run.check_out(new)
        folder = out or Path(resources.enter_context(TemporaryDirectory(prefix="lfpipe-replay-")))
        run.check_out(folder)
        field = opened(scene, config)
        if against is not None:
            inputs = {"sequence": about_sequence(sequence), "scene": about_scene(field)}
            check_reference(against, inputs)
        run.clear_out(folder)
        stores_pictures = pace == "step" and (out is not None or expect is not None)
        _summary(run.replay(sequence, field, config, pace, folder, stores_pictures, say))
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


def _check_outputs(pace: str, out: Path | None, expect: Path | None, update: bool) -> None:
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
