"""The results of a replay: `report.json` as plain data, and JUnit XML for CI systems, a test case
per part of the comparison.
"""

import hashlib
import itertools
import struct
import sys
import zlib
from collections import Counter
from collections.abc import Sequence as Several
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import attrs
import numpy as np

from lfpipe.config import Config
from lfpipe.errors import MESSAGE_CHARS, plain
from lfpipe.files.output import write_output
from lfpipe.files.safe_files import check_links, read_text
from lfpipe.files.trace import check_sides, trace_lines
from lfpipe.files.untrusted import json_fields
from lfpipe.host.machine import versions
from lfpipe.render.listeners import PICTURES
from lfpipe.scene.lightfield import LightField
from lfpipe.sequence.eyes import Truth, read_truth, summary
from lfpipe.sequence.folder import Sequence
from lfpipe.sequence.packets import INDEX, PACKETS
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
    made = sequence.manifest.get("made")
    return {
        "name": sequence.path.resolve().name,
        "frames": len(sequence.packets),
        "checksums": (
            {"made": made} if made else {name: checksums.get(name, "") for name in (PACKETS, INDEX)}
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
    seen = len({line["source_seq"] for line in lines})
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
            "frames_shown": seen,
            "composed": len(composed),
            "faces": len({line["source_seq"] for line in lines if line["face"]}),
            "dropped": {name: stage.dropped for name, stage in stages.items()},
            "restarts": {name: stage.restarts for name, stage in stages.items()},
        },
        "digests": digests(lines) if steady and lines else None,
        "truth_error": _truth_error(truth, lines, shown_ns) if truth and lines else None,
        "rate_hz": round((seen - 1) / span_ns * 1e9, 2) if span_ns > 0 else 0.0,
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
