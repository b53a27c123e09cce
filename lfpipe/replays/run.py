"""Runs the real stages on a recorded sequence and writes the results to a folder: `report.json` as
plain data, and JUnit XML for CI systems, a test case per part of the comparison.

- step: every frame passes every stage before the next one starts; eyes, views and pictures depend
  only on the sequence, the scene and the configuration
- max: as fast as possible; nothing is lost, and the results equal those of step
- recorded, HZ: in real time, on the clocks of a live session; late frames are dropped and counted
"""

import contextlib
import errno
import hashlib
import itertools
import json
import os
import re
import shutil
import struct
import sys
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from collections.abc import Sequence as Several
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import attrs
import numpy as np

from lfpipe import config as config_module
from lfpipe.config import Config, SessionOptions
from lfpipe.config.session_options import (
    CameraViewer,
    Live,
    Lossless,
    RecordedEyes,
    ReplayOutput,
    Viewer,
)
from lfpipe.errors import MESSAGE_CHARS, UserError, plain
from lfpipe.files.safe_files import (
    PRIVATE_FOLDER,
    WORK_NAME,
    check_links,
    check_sides,
    json_fields,
    read_text,
    reason,
    trace_lines,
    write_output,
)
from lfpipe.host import signals
from lfpipe.host.files import is_dir
from lfpipe.host.worker import versions
from lfpipe.render.listeners import PICTURES
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import summarize
from lfpipe.sequence.folder import MANIFEST, Sequence
from lfpipe.sequence.folder import Sequence as Recorded
from lfpipe.sequence.packets import COPY, INDEX, PACKETS, Truth, read_truth, summary
from lfpipe.supervisor.metrics import SessionMetrics

FORMAT = 1
REPORT, TRACE = "report.json", "trace.jsonl"
DIFFERENCE = "difference"  # folder of pictures that show one
FILES = (REPORT, TRACE, PICTURES, f"{PICTURES}/{INDEX}", f"{PICTURES}/{PACKETS}")
STEADY = ("step", "max")  # paces whose results do not depend on any clock
COUNTED = ("frames", "pictures", "faces")  # equal in runs of equal results
WRITTEN = "use a folder that `lfpipe replay --out` wrote; --update rewrites the reference"
Line = dict[str, Any]  # of a trace
Report = dict[str, Any]  # report.json, with the keys of docs/replay.md


def read_trace(folder: Path, steady: bool = True, most_lines: int = sys.maxsize) -> list[Line]:
    """The first most_lines lines of the trace in folder. steady: of a pace whose lines have
    filtered eyes and a picture's digest.

    Raises UserError if it cannot be read.
    """
    read: list[Line] = []
    for fields in itertools.islice(trace_lines(folder / TRACE, WRITTEN), most_lines):
        for name in ("eyes_raw", "eyes_used", *(("eyes_filtered",) if steady else ())):
            check_sides(fields, name)
        if steady:
            fields.text("picture", 100)
        read.append(dict(fields.values))
    return read


def read_report(folder: Path) -> Report:
    """The report in folder: of this version, with all tables that a comparison reads, and counts
    that are numbers.

    Raises UserError if it is not such a report.
    """
    check_links(folder, FILES)
    path = folder / REPORT
    fields = json_fields(read_text(path, str(path), WRITTEN), str(path), WRITTEN)
    fields.integer("format", FORMAT, FORMAT)
    for name in ("versions", "config", "plan", "sequence", "scene"):
        fields.table(name)
    for name in COUNTED:
        fields.table("counts").integer(name, 0, 1 << 53)
    return dict(fields.values)


def pair(line: Line, name: str) -> tuple[float, ...]:
    """(left x, left y, right x, right y) of an entry of a line."""
    sides = line[name]
    return (*sides["left"], *sides["right"])


def _digest(parts: list[bytes]) -> str:
    return hashlib.sha256(b"".join(parts)).hexdigest()


def digests(lines: list[Line]) -> dict[str, str]:
    """sha256 over all frames of the exact bytes of eyes (raw, filtered, used), views, pictures."""
    names = ("eyes_raw", "eyes_filtered", "eyes_used")
    eyes = [
        struct.pack("<12d?", *(v for name in names for v in pair(line, name)), line["face"])
        for line in lines
    ]
    views = [struct.pack("<4d", *pair(line, "view")) + line["method"].encode() for line in lines]
    return {
        "eyes": _digest(eyes),
        "views": _digest(views),
        "pictures": _digest([line["picture"].encode() for line in lines]),
    }


def about_scene(field: LightField) -> dict[str, Any]:
    """Name, shape, and digests of the views, both unordered and in order."""
    views = np.asarray(field.views)
    places = np.ndindex(field.frames, field.rows, field.cols)
    sums = [zlib.crc32(np.ascontiguousarray(views[place]).data) for place in places]
    shape = {
        name: getattr(field, name) for name in ("frames", "rows", "cols", "height_px", "width_px")
    }
    digests_of = {
        name: _digest([struct.pack("<I", one) for one in ordered])
        for name, ordered in (("views", sorted(sums)), ("order", sums))
    }
    return {"name": field.name, **shape, **digests_of}


def about_sequence(sequence: Sequence) -> dict[str, Any]:
    """Name, number of frames, checksums of frames and stamps, rate by the stamps.

    A generated sequence has the name of its generator under "made" in its manifest. Its packets
    depend on the version of the encoder, so it is identified by that name instead of checksums.
    """
    checksums = sequence.manifest.get("checksums", {})
    generator = sequence.manifest.get("made")
    return {
        "name": sequence.path.resolve().name,
        "frames": len(sequence.packets),
        "checksums": (
            {"made": generator}
            if generator
            else {name: checksums.get(name, "") for name in (PACKETS, INDEX)}
        ),
        "rate_hz": round(sequence.measured_hz, 4),
    }


def _quantiles_ms(values_ns: list[int]) -> dict[str, float]:
    ranks = {"p50_ms": 50, "p95_ms": 95, "p99_ms": 99, "max_ms": 100}
    return (
        {
            name: round(float(np.percentile(values_ns, rank)) / 1e6, 4)
            for name, rank in ranks.items()
        }
        if values_ns
        else {}
    )


def _truth_error(truth: Truth, lines: list[Line], shown_ns: list[int]) -> dict[str, Any]:
    """Errors of the measured eyes (raw, at the frame's time) and of the eyes used for the picture
    (used, when it is seen).
    """
    stamps_ns = np.array([line["t_sensor_ns"] for line in lines])
    faces = np.array([line["face"] for line in lines], np.bool_)
    errors = {}
    for name, t_ns in (("raw", stamps_ns), ("used", np.array(shown_ns))):
        eyes_px = np.reshape([pair(line, f"eyes_{name}") for line in lines], (-1, 2, 2))
        errors[name] = summary(truth.error_px(eyes_px, t_ns - stamps_ns[0])[faces])
    return errors


def make_report(
    sequence: Sequence,
    field: LightField,
    config: Config,
    pace: str,
    folder: Path,
    final: SessionMetrics,
) -> Report:
    """The report of a run whose trace is in folder.

    final: the session at its end. Keys as in docs/replay.md.
    """
    from lfpipe.render.plan import make_plan

    steady = pace in STEADY
    lines = read_trace(folder, steady)
    plan = attrs.asdict(make_plan(field, config))
    plan["left_out"] = [entry["what"] for entry in plan["left_out"]]
    latency_ns = round(config.replay.latency_ms * 1e6)
    shown_ns = [
        line["t_sensor_ns"] + latency_ns if steady else line["t_presented_ns"] for line in lines
    ]
    truth = read_truth(sequence.path)
    stages = final.stages
    span_ns = lines[-1]["t_presented_ns"] - lines[0]["t_presented_ns"] if lines else 0
    frames_shown = len({line["source_seq"] for line in lines})
    composed = [line for line in lines if line["composed"]]
    return {
        "format": FORMAT,
        "versions": versions(),
        "pace": pace,
        "sequence": about_sequence(sequence),
        "scene": about_scene(field),
        "config": attrs.asdict(config),
        "plan": plan,
        "counts": {
            "frames": len(sequence.packets),
            "lost_in_recording": sequence.lost,
            "pictures": len(lines),
            "frames_shown": frames_shown,
            "composed": len(composed),
            "faces": len({line["source_seq"] for line in lines if line["face"]}),
            "dropped": {name: stage.dropped for name, stage in stages.items()},
            "restarts": {name: stage.restarts for name, stage in stages.items()},
        },
        "digests": digests(lines) if steady and lines else None,
        "truth_error": _truth_error(truth, lines, shown_ns) if truth and lines else None,
        "rate_hz": round((frames_shown - 1) / span_ns * 1e9, 2) if span_ns > 0 else 0.0,
        "latency": {
            **{name: {"wait": stage.wait, "busy": stage.busy} for name, stage in stages.items()},
            "end_to_end": _quantiles_ms(
                [line["t_presented_ns"] - line["t_read_ns"] for line in composed]
            ),
        },
        "cpu": {name: stage.cpu_s for name, stage in stages.items()},
    }


def write_junit(
    path: Path, name: str, cases: Several[tuple[str, list[str]]], error: str, seconds: float
) -> None:
    """name: of the sequence. error: why there is no outcome; "" if cases holds the outcome.

    Raises UserError if path cannot be written.
    """
    name = plain(name, 200)
    classname = f"lfpipe.replay.{name}"
    whole = TestCase(
        classname=classname, name="replay", kind="error" if error else "", message=error, text=error
    )
    parts = [
        TestCase(
            classname=classname,
            name=case,
            kind="failure" if reasons else "",
            message=reasons[0] if reasons else "",
            text="\n".join(reasons),
        )
        for case, reasons in cases
    ]
    write_output(path, junit(f"lfpipe replay {name}", [whole, *parts], seconds), label="--junit")


# JUnit XML, as CI services read it: outcomes of replays and of sweeps.

TEXT_CHARS = 20_000  # of one test case
Kind = Literal["", "failure", "error", "skipped"]


@attrs.frozen(kw_only=True)
class TestCase:
    """A case of a JUnit report."""

    classname: str
    name: str
    kind: Kind = ""
    """Of what went wrong, "" if nothing did."""
    message: str = ""
    """Short description of that."""
    text: str = ""
    """Long description of that."""
    seconds: float | None = None
    """None if not measured."""


def junit(name: str, cases: Several[TestCase], seconds: float | None = None) -> bytes:
    """A suite of test cases. seconds: of all of them."""
    kinds = Counter(case.kind for case in cases)
    counts = {
        "tests": len(cases),
        "failures": kinds["failure"],
        "errors": kinds["error"],
        "skipped": kinds["skipped"],
    }
    about = {"name": name, **{key: str(count) for key, count in counts.items()}}
    suite = ElementTree.Element("testsuite", about | _time(seconds))
    for case in cases:
        about = {"classname": case.classname, "name": plain(case.name, 500)}
        entry = ElementTree.SubElement(suite, "testcase", about | _time(case.seconds))
        if case.kind:
            message = {"message": plain(case.message, MESSAGE_CHARS)}
            what = ElementTree.SubElement(entry, case.kind, message)
            what.text = plain(case.text, TEXT_CHARS)
    return bytes(ElementTree.tostring(suite, "utf-8", xml_declaration=True))


def _time(seconds: float | None) -> dict[str, str]:
    return {} if seconds is None else {"time": f"{seconds:.3f}"}


_FILE = re.compile(
    r"report\.json|trace\.jsonl|(first|last|worst)\.png|pictures/frames\.(bin|jsonl)"
    r"|difference/frame_\d+_\w+\.png"
)
PLACE = "name a folder that you may write to, on a disk with free space"


class ReplayFailed(Exception):
    """The stages did not reach the end of the sequence; the text explains why."""


def replay_config(sequence: Recorded, file: str | None, sets: tuple[str, ...]) -> Config:
    """The configuration of a replay: the recorded camera, and the user's current settings for
    everything else.

    Raises UserError for a wrong key or value.
    """
    config = config_module.load(file, sets)
    keys = {config_module.parse_set(text)[0] for text in sets}
    recorded = sequence.manifest.get("config", {}).get("camera", {})
    camera = {f"camera.{key}": recorded[key] for key in ("focal_px", "fov_deg") if key in recorded}
    size = dict(zip(("width_px", "height_px"), sequence.size_px, strict=True))
    # because its JPEGs may have been scaled
    camera |= {f"camera.{key}": recorded.get(key, size_px) for key, size_px in size.items()}
    camera["camera.rate_hz"] = min(max(sequence.measured_hz, 0.1), 1000.0)
    try:
        return config_module.updated(
            config, {key: value for key, value in camera.items() if key not in keys}
        )
    except UserError as error:
        what = error.message.removeprefix("configuration: ")
        raise UserError(
            f"{sequence.path / MANIFEST}: config: {what}", f"{COPY}, or override it with --set"
        ) from None


def check_out(folder: Path) -> None:
    """Creates folder if it does not exist.

    Raises UserError if it is not writable, or contains anything but results.
    """
    with writing(folder):
        folder.mkdir(PRIVATE_FOLDER, parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "Permission denied")
        strangers = sorted(
            name
            for path in folder.rglob("*")
            if not _is_result(path, name := path.relative_to(folder).as_posix())
        )
        if strangers:
            raise UserError(
                f"{folder}: contains {strangers[0]}, which is not from a replay",
                "use a new or an empty folder",
            )


def _is_result(path: Path, name: str) -> bool:
    """Whether an entry of a folder is of a replay, by its name."""
    if path.is_symlink() or is_dir(path):
        return name in (PICTURES, DIFFERENCE) and not path.is_symlink()
    return bool(_FILE.fullmatch(name) or WORK_NAME.fullmatch(path.name))  # of a killed run


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turns errors of writing a folder into UserError."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise UserError(f"{folder}: cannot be written: {reason(error)}", PLACE) from None


def clear_out(folder: Path) -> None:
    """Removes the results of an earlier run from folder. Raises UserError if that fails."""
    check_out(folder)
    with writing(folder):
        for path in folder.iterdir():
            shutil.rmtree(path) if is_dir(path) else path.unlink()


def update_reference(reference: Path, folder: Path) -> None:
    """Replaces reference by a folder with those files of a run that a comparison reads.

    Raises UserError if that fails; the old reference is then kept.
    """
    place = Path(os.path.realpath(reference))
    with writing(reference), tempfile.TemporaryDirectory(dir=place.parent) as work:
        new, old = Path(work, "new"), Path(work, "old")
        new.mkdir(PRIVATE_FOLDER)
        for path in (folder / name for name in (REPORT, TRACE, PICTURES)):
            if is_dir(path):
                shutil.copytree(path, new / path.name)
            else:
                shutil.copy(path, new)
        place.rename(old)
        new.rename(place)


def replay(
    sequence: Recorded,
    field: LightField,
    config: Config,
    pace: str,
    folder: Path,
    pictures: bool,
    tell: Callable[[str], None] = print,
) -> Report:
    """Runs sequence through the stages and writes trace, report and pictures to folder (see
    `clear_out`); returns the report.

    pace: step, max, recorded or a rate in Hz. pictures: store some for comparison. Raises UserError
    for a user error, ReplayFailed if a stage fails, signals.Interrupted.
    """
    from lfpipe.supervisor.session import run_session
    from lfpipe.transport.control import Session

    steady = pace in STEADY
    source = f"file:{sequence.path.resolve()}?loop=0&pace={'max' if steady else pace}"
    output = ReplayOutput(str(folder.resolve()), str(sequence.path.resolve()), pictures)
    rate_hz = float(pace) if pace not in ("step", "max", "recorded") else sequence.measured_hz
    # tracked also with a scene of one view: the eyes are compared
    viewer: Viewer = CameraViewer(source=source, rate_hz=rate_hz)
    if sequence.holds_eyes:
        viewer = RecordedEyes(source=source, rate_hz=rate_hz, folder=str(sequence.path.resolve()))
    options = SessionOptions(
        scene=summarize(field),
        viewer=viewer,
        clock=Lossless(lock_step=pace == "step", output=output) if steady else Live(),
        trace=str((folder / TRACE).resolve()),
    )
    outcome = run_session(Session(f"replay.{os.getpid()}"), config, options, tell)
    if outcome.user_error:
        raise UserError(outcome.failure or outcome.reason, outcome.remedy)
    if outcome.signum:
        raise signals.Interrupted(outcome.signum)
    if outcome.failure or not outcome.source_ended:
        raise ReplayFailed(outcome.failure or outcome.reason)
    assert outcome.final is not None
    report = make_report(sequence, field, config, pace, folder, outcome.final)
    restarted = [name for name, count in report["counts"]["restarts"].items() if count]
    if restarted:
        raise ReplayFailed(
            f"{', '.join(restarted)} failed during the replay and had to be restarted"
        )
    if steady and report["counts"]["pictures"] != len(sequence.packets):
        raise ReplayFailed(
            f"{report['counts']['pictures']} pictures of {len(sequence.packets)} frames: a stage"
            " lost some"
        )
    write_output(folder / REPORT, json.dumps(report, indent=1).encode() + b"\n")
    return report
