"""results.json: every sample, with the machine, versions, commit and command line."""

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
from lfpipe.bench.model import Cell, Diagram, Figure, Samples, Skipped, Subject, Table
from lfpipe.bench.stats import MIN_SAMPLES, noise
from lfpipe.errors import UserError
from lfpipe.files.safe_files import read_bytes, reason
from lfpipe.files.untrusted import Fields, json_fields
from lfpipe.host.paths import is_dir
from lfpipe.host.processes import usable_cores
from lfpipe.host.versions import versions

FORMAT = 1
MAX_BYTES, MAX_ITEMS = 64 << 20, 1_000_000  # of results.json, and of any list in it


@attrs.define
class Measured:
    """Samples of each figure of one candidate: errors, measured once; turns, timed; parts of long turns."""

    curve: str
    knob: str
    paper: bool
    errors: Samples = attrs.Factory(dict)
    turns: Samples = attrs.Factory(dict)
    parts: Samples = attrs.Factory(dict)
    line: str = ""

    @property
    def name(self) -> str:
        return f"{self.curve}, {self.knob}" if self.knob else self.curve

    def value(self, figure: Figure) -> float:
        """The figure as one number; NaN if it was not measured."""
        return figure.of(self.errors.get(figure.key) or self.turns.get(figure.key) or [])

    def noise(self, key: str) -> float:
        """Width of the 95 % interval of the median of a timed figure, over the median. Uses the parts if there are too few turns;
        infinite if there are too few of both."""
        turns = self.turns.get(key, [])
        return noise(turns if len(turns) >= MIN_SAMPLES else self.parts.get(key, []))


@attrs.define
class SubjectResults:
    """omissions: failed candidates with the reason. skipped: measurements that do not apply to the inputs."""

    name: str
    measured: dict[str, Measured] = attrs.Factory(dict)
    omissions: dict[str, str] = attrs.Factory(dict)
    skipped: list[Skipped] = attrs.Factory(list)
    tables: list[Table] = attrs.Factory(list)
    seconds: float = 0.0
    done: bool = False


@attrs.define
class Results:
    """A run. about: machine, versions, commit, command line, inputs."""

    about: dict[str, Any]
    subjects: dict[str, SubjectResults] = attrs.Factory(dict)

    def write(self, folder: Path) -> None:
        """Replaces results.json atomically. Raises UserError if the folder cannot be written."""
        content = {"format": FORMAT, **attrs.asdict(self)}
        part = folder / f".results.{os.getpid()}"
        try:
            part.write_text(json.dumps(_rounded(content), indent=1, allow_nan=False))
            part.replace(folder / "results.json")
        except OSError as error:
            raise UserError(f"{folder}: cannot be written: {error.strerror}", "choose another folder with --out DIR") from None


def _rounded(value: Any) -> Any:
    """Floats with seven digits, null if not finite: a tenth of the bytes, without relevant loss."""
    if isinstance(value, float):
        return float(f"{value:.7g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(part) for part in value]
    return value


def read(folder: Path) -> Results:
    """The results in a folder. Raises UserError if there are none, or they have another format."""
    path = folder / "results.json" if is_dir(folder) else folder
    remedy = "give a folder written by `lfpipe bench --out`"
    try:
        content = json_fields(read_bytes(path, MAX_BYTES), str(path), remedy)
        if content.values.get("format") != FORMAT:
            found = f"{content.values.get('format')!r:.100}"
            raise UserError(f"{path}: format {found}; this version reads {FORMAT}", "measure again")
        about, parts = content.table("about"), content.table("subjects")
        return Results(dict(about.values), {name: _subject(parts.table(name)) for name in parts.values})
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        why = reason(error) if isinstance(error, OSError | ValueError) else f"unexpected form: {error!r:.200}"
        raise UserError(f"{path}: no results of `lfpipe bench`: {why}", remedy) from None


def _subject(part: Fields) -> SubjectResults:
    tables = [
        Table(t["title"], t["note"], tuple(t["head"]), tuple(tuple(Cell(**cell) for cell in row) for row in t["rows"]))
        for t in part.items("tables", MAX_ITEMS)
    ]
    found, omissions = part.table("measured"), part.table("omissions")
    return SubjectResults(
        part.text("name"),
        {name: _measured(found.table(name)) for name in found.values},
        {name: omissions.text(name) for name in omissions.values},
        [Skipped(**value) for value in part.items("skipped", MAX_ITEMS)],
        tables,
        part.number("seconds", 0, math.inf),
        part.flag("done"),
    )


def _measured(part: Fields) -> Measured:
    samples = {name: _samples(part.table(name)) for name in ("errors", "turns", "parts")}
    return Measured(part.text("curve"), part.text("knob"), part.flag("paper"), **samples, line=part.text("line"))


def _samples(part: Fields) -> Samples:
    """Samples by figure; null represents a number that was not finite."""
    found: Samples = {}
    for name in part.values:
        listed = part.items(name, MAX_ITEMS)
        if not all(each is None or (isinstance(each, int | float) and not isinstance(each, bool)) for each in listed):
            raise UserError(f"{part.where}: {name} holds something that is not a number", part.remedy)
        found[name] = [math.nan if each is None else float(each) for each in listed]
    return found


def figures_of(folder: Path, name: str) -> tuple[dict[str, Any], list[str], list[str]]:
    """Figures of a subject by name, its failures, and what it left out, each with its reason."""
    from lfpipe.bench.subjects import SUBJECTS

    found, subject = read(folder).subjects[name], SUBJECTS[name]
    measured = [(f"{one}: {of.key}", values.value(of)) for one, values in found.measured.items() for of in subject.figures]
    figures: dict[str, Any] = {name: float(f"{value:.6g}") for name, value in measured}
    cells = [each for table in found.tables for row in table.rows for each in row]
    for state in ("ok", "degraded", "failed"):
        if any(each.state for each in cells):
            figures[f"cells {state}"] = float(sum(each.state == state for each in cells))
    return figures, [f"{one}: {why}" for one, why in found.omissions.items()], [f"{one.what}: {one.why}" for one in found.skipped]


def _output(command: list[str]) -> str:
    try:
        here = Path(lfpipe.__file__).parent
        done = subprocess.run(command, capture_output=True, text=True, cwd=here, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def source_digest() -> str:
    """Hash of the package's own files: a changed build measures again."""
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(lfpipe.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def describe_run(inputs: Inputs) -> dict[str, Any]:
    """All conditions that the figures depend on."""
    built = versions()
    processor = built.pop("processor")
    commit = _output(["git", "rev-parse", "--short=12", "HEAD"])
    changed = bool(_output(["git", "status", "--porcelain", "--untracked-files=no"]))
    return {
        "identity": {
            "quick": inputs.quick,
            "scenes": [field.manifest.get("key", "") for _, field in inputs.fields],
            "sequence": [inputs.sequence.path.name, len(inputs.sequence.frames), inputs.sequence.truth is not None],
            "source": source_digest(),
            "versions": built,
        },
        "commit": commit + (" with changes" if changed else "") if commit else "not a git checkout",
        "versions": built,
        "machine": {
            "processor": processor,
            "cores": len(usable_cores()),
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
    """Diagrams that hold no point: name -> why."""
    empty = {}
    for diagram in subject.diagrams:
        keys = [diagram.x, diagram.y] if isinstance(diagram, Diagram) else [key for _, key in diagram.keys]
        figures = [subject.figure(key) for key in keys]
        measured = [one for one in found.measured.values() if isinstance(diagram, Diagram) or one.knob in diagram.knobs]
        if not any(all(math.isfinite(one.value(figure)) for figure in figures) for one in measured):
            missing = [f.label for f in figures[:2] if all(math.isnan(one.value(f)) for one in found.measured.values())]
            empty[diagram.name] = f'diagram "{diagram.title}": nothing measured of {", ".join(missing) or "it"}'
    return empty
