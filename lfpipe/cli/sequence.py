"""`lfpipe record` and `lfpipe sequence`: records a camera; inspects and converts sequences."""

import contextlib
import itertools
import json
import math
import os
import shutil
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import click
import numpy as np

from lfpipe.capture.open_source import camera_name, camera_settings, check_source, clock_of
from lfpipe.capture.recordings import STAMP_ROUNDING_NS, Schedule, open_recording
from lfpipe.cli.launch import exit_code
from lfpipe.cli.options import CAMERA, DURATION, PATH, Number, with_config
from lfpipe.cli.plugged import Group
from lfpipe.cli.terminal import print_result, say
from lfpipe.config import Config, SessionOptions
from lfpipe.config.check import MAX_LISTED
from lfpipe.config.modes import RecordedEyes
from lfpipe.config.user_files import with_measured_focal
from lfpipe.errors import UserError, plain
from lfpipe.files.safe_files import create_private, open_regular
from lfpipe.host.files import exists
from lfpipe.host.machine import versions
from lfpipe.sequence import edit
from lfpipe.sequence.eyes import TRUTH, read_truth, table_of
from lfpipe.sequence.folder import (
    check_out,
    check_sums,
    new_sequence,
    open_sequence,
    remove_empty,
)
from lfpipe.sequence.packets import encoded
from lfpipe.supervisor.session import run_session
from lfpipe.transport.session import Session

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
        "codecs": sorted(recorded.codecs),
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
    said: list[str] = []
    count = 0
    remedy = ""
    for check_one in checks:
        try:
            check_one()
        except UserError as error:  # whose traceback holds the whole frame
            count += 1
            said += [error.message] * (count <= MAX_LISTED)
            remedy = remedy or error.remedy
    if said:
        said += [f"and {count - MAX_LISTED} more"] * (count > MAX_LISTED)
        raise UserError("\n  ".join(said), remedy)
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
    frames = edit.cut(open_sequence(path, verify=False), out, begin_s, end_s)
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
