"""results.json: every sample, with the machine, versions, commit and command line; written whole, read back to go on."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import attrs

import lfpipe
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.model import Cell, Diagram, Figure, Profile, Skipped, Subject, Table
from lfpipe.bench.numbers import FEWEST, noise
from lfpipe.errors import UserError
from lfpipe.files import read_bytes, reason
from lfpipe.untrusted import Fields, json_fields
from lfpipe.versions import versions

FORMAT = 1
MAX_BYTES, MAX_ITEMS = 64 << 20, 1_000_000  # of results.json, and of any list in it


@attrs.define
class Measured:
    """One candidate: samples of each figure, from the one measurement (errors) and from timed turns; parts: samples within turns
    that are long."""

    curve: str
    knob: str
    paper: bool
    errors: dict[str, list[float]] = attrs.Factory(dict)
    turns: dict[str, list[float]] = attrs.Factory(dict)
    parts: dict[str, list[float]] = attrs.Factory(dict)
    line: str = ""

    @property
    def name(self) -> str:
        return f"{self.curve}, {self.knob}" if self.knob else self.curve

    def value(self, figure: Figure) -> float:
        """The figure as one number; NaN where it was not measured."""
        return figure.of(self.errors.get(figure.key) or self.turns.get(figure.key) or [])

    def noise(self, key: str) -> float:
        """Width of the 95 % interval of the median of a timed figure, over the median: of its turns, or of their parts where
        the turns are too few. Infinite where both are."""
        turns = self.turns.get(key, [])
        return noise(turns if len(turns) >= FEWEST else self.parts.get(key, []))


@attrs.define
class SubjectResults:
    """What was found of one subject. omissions: candidates that failed, with the reason. skipped: what makes no sense here."""

    name: str
    measured: dict[str, Measured] = attrs.Factory(dict)
    omissions: dict[str, str] = attrs.Factory(dict)
    skipped: list[Skipped] = attrs.Factory(list)
    tables: list[Table] = attrs.Factory(list)
    seconds: float = 0.0
    done: bool = False


@attrs.define
class Results:
    """A whole run. about: machine, versions, commit, command line, inputs."""

    about: dict[str, Any]
    subjects: dict[str, SubjectResults] = attrs.Factory(dict)

    def write(self, folder: Path) -> None:
        """Writes results.json whole or not at all. Raises UserError where the folder cannot be written."""
        told = {"format": FORMAT, **attrs.asdict(self)}
        part = folder / f".results.{os.getpid()}"
        try:
            part.write_text(json.dumps(_rounded(told), indent=1, allow_nan=False))
            part.replace(folder / "results.json")
        except OSError as error:
            raise UserError(
                f"{folder}: results cannot be written: {error.strerror}", "name another folder with --out DIR"
            ) from None


def _rounded(value: Any) -> Any:
    """Floats at seven digits, what is not finite as null: a tenth of the bytes, and nothing that matters."""
    if isinstance(value, float):
        return float(f"{value:.7g}") if value - value == 0 else None
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(part) for part in value]
    return value


def read(folder: Path) -> Results:
    """The results in a folder. Raises UserError where there are none, or of another format."""
    path = folder / "results.json" if folder.is_dir() else folder
    remedy = "a folder that `lfpipe bench --out` wrote"
    try:
        told = json_fields(read_bytes(path, MAX_BYTES), str(path), remedy)
        if told.values.get("format") != FORMAT:
            raise UserError(f"{path}: format {told.values.get('format')!r:.100}, this is {FORMAT}", "measure anew")
        about, parts = told.table("about"), told.table("subjects")
        return Results(dict(about.values), {name: _subject(parts.table(name)) for name in parts.values})
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        why = reason(error) if isinstance(error, OSError | ValueError) else f"not in their form: {error!r:.200}"
        raise UserError(f"{path}: no results of `lfpipe bench`: {why}", remedy) from None


def _subject(part: Fields) -> SubjectResults:
    tables = [
        Table(t["title"], t["note"], tuple(t["head"]), tuple(tuple(Cell(**cell) for cell in row) for row in t["rows"]))
        for t in part.items("tables", MAX_ITEMS)
    ]
    found = part.table("measured")
    measured = {name: _measured(found.table(name)) for name in found.values}
    skipped = [Skipped(**value) for value in part.items("skipped", MAX_ITEMS)]
    omissions = part.table("omissions")
    reasons = {name: omissions.text(name) for name in omissions.values}
    return SubjectResults(
        part.text("name"), measured, reasons, skipped, tables, part.number("seconds", 0, math.inf), part.flag("done")
    )


def _measured(part: Fields) -> Measured:
    samples = {name: _samples(part.table(name)) for name in ("errors", "turns", "parts")}
    return Measured(part.text("curve"), part.text("knob"), part.flag("paper"), **samples, line=part.text("line"))


def _samples(part: Fields) -> dict[str, list[float]]:
    """Samples by figure; null, which stands for what was not finite, as NaN."""
    found: dict[str, list[float]] = {}
    for name in part.values:
        listed = part.items(name, MAX_ITEMS)
        if not all(each is None or (isinstance(each, int | float) and not isinstance(each, bool)) for each in listed):
            raise UserError(f"{part.where}: {name} holds what is no number", part.remedy)
        found[name] = [math.nan if each is None else float(each) for each in listed]
    return found


def _said(command: list[str]) -> str:
    try:
        here = Path(lfpipe.__file__).parent
        done = subprocess.run(command, capture_output=True, text=True, cwd=here, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _source() -> str:
    """Hash of the package's own files: a changed build measures anew."""
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(lfpipe.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def about(inputs: Inputs) -> dict[str, Any]:
    """What the figures depend on."""
    built = versions()
    processor = built.pop("processor")
    commit = _said(["git", "rev-parse", "--short=12", "HEAD"])
    changed = bool(_said(["git", "status", "--porcelain", "--untracked-files=no"]))
    return {
        "identity": {
            "quick": inputs.quick,
            "scenes": [field.manifest.get("key", "") for _, field in inputs.fields],
            "sequence": [inputs.sequence.path.name, len(inputs.sequence.frames), inputs.sequence.truth is not None],
            "source": _source(),
            "versions": built,
        },
        "commit": commit + (" with changes" if changed else "") if commit else "not a git checkout",
        "versions": built,
        "machine": {
            "processor": processor,
            "cores": len(os.sched_getaffinity(0)),
            "system": f"{platform.system()} {platform.release()}",
            "load": round(os.getloadavg()[0], 2),
        },
        "command": " ".join(["lfpipe", *sys.argv[1:]]),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "scenes": [
            f"{one.name}: {one.rows}x{one.cols} views of {one.width_px}x{one.height_px} px, disparity {one.disparity_source}"
            for _, one in inputs.fields
        ],
        "sequence": f"{inputs.sequence.path.name}: {len(inputs.sequence.frames)} frames at {inputs.sequence.rate_hz:g} Hz, "
        + ("truth known" if inputs.sequence.truth else "no truth"),
    }


def empty_diagrams(subject: Subject, found: SubjectResults) -> dict[str, str]:
    """Diagrams that make no sense for the inputs: name -> why."""
    out = {}
    for diagram in subject.diagrams:
        keys = [diagram.x, diagram.y] if isinstance(diagram, Diagram) else [key for _, key in diagram.keys]
        figures = [subject.figure(key) for key in keys]
        some = [m for m in found.measured.values() if _in(diagram, m) and all(m.value(f) == m.value(f) for f in figures)]
        if not some:
            missing = ", ".join(f.label for f in figures[:2] if all(m.value(f) != m.value(f) for m in found.measured.values()))
            out[diagram.name] = f'diagram "{diagram.title}": nothing measured of {missing or "it"}'
    return out


def _in(diagram: Diagram | Profile, one: Measured) -> bool:
    return isinstance(diagram, Diagram) or one.knob in diagram.knobs
