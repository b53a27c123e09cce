"""The one form of all results. A subject gives candidates, which are measured, or tables; results.json holds what was found.

A candidate is one point of a chart, named by its curve and its knob (the setting that varies along the curve). The figures of a
candidate are numbers with an interval; tables have cells with a state.
"""

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import attrs
import numpy as np

from lfpipe.bench.stats import MIN_SAMPLES
from lfpipe.errors import UserError
from lfpipe.files.safe_files import read_bytes, reason
from lfpipe.files.untrusted import json_fields

if TYPE_CHECKING:
    from lfpipe.bench.inputs import Inputs

FORMAT = "lfpipe-bench-2"
MAX_BYTES = 16 << 20  # of results.json
State = Literal["", "ok", "degraded", "failed"]
Samples = dict[str, list[float]]  # by the key of a figure


@attrs.frozen
class Figure:
    """A measured quantity. reduce: how samples become one number."""

    key: str
    label: str
    unit: str
    reduce: Literal["median", "rms", "mean", "max"] = "median"

    @property
    def axis(self) -> str:
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def of(self, samples: Sequence[float]) -> float:
        """The samples as one number."""
        if self.reduce == "rms":
            return float(np.sqrt(np.mean(np.square(samples))))
        if self.reduce == "max":
            return max(samples)
        return float(np.median(samples) if self.reduce == "median" else np.mean(samples))


@attrs.frozen(eq=False)
class Prepared:
    """A candidate ready to be measured. errors: samples of each figure, measured once. turn: one timed turn with a sample per
    figure, or with those of its parts if a turn is long; None if nothing is timed."""

    errors: Callable[[], Samples]
    turn: Callable[[], Mapping[str, float | list[float]]] | None = None
    close: Callable[[], None] = lambda: None


@attrs.frozen(eq=False)
class Candidate:
    """paper: this is what the paper does; used: what lfpipe does by default. line: points with the same line are joined."""

    curve: str
    knob: str
    prepare: Callable[[], Prepared]
    paper: bool = False
    used: bool = False
    line: str = ""

    @property
    def name(self) -> str:
        return f"{self.curve}, {self.knob}" if self.knob else self.curve


@attrs.frozen
class Skipped:
    """An omitted measurement and the reason: it does not apply to the inputs, or --quick saves its time."""

    what: str
    why: str


@attrs.frozen
class Cell:
    """only: where a cell that is not ok matters, "" for what is in use by default, else the setting that reaches it."""

    text: str
    state: State = ""
    only: str = ""


@attrs.frozen
class Table:
    """Rows of cells under a head. note: explains the cells."""

    title: str
    note: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def failures(self) -> Iterator[tuple[str, str, Cell]]:
        """(row, column, cell) of every cell that is not ok."""
        for row in self.rows:
            yield from ((row[0].text, self.head[k], cell) for k, cell in enumerate(row) if cell.state in ("degraded", "failed"))


@attrs.frozen
class Chart:
    """Error against run time of all candidates: keys of the figures on both logarithmic axes, less is better."""

    name: str
    title: str
    x: str
    y: str


@attrs.frozen
class Profile:
    """One line per candidate whose knob is in `knobs`. keys: (position on x, figure)."""

    name: str
    title: str
    x_axis: str
    y_axis: str
    keys: tuple[tuple[float, str], ...]
    knobs: tuple[str, ...]


@attrs.frozen
class Choice:
    """What a subject decides. key: of the configuration. x, y: figures of cost and error. limit: of the cost, with its reason.
    Only candidates with the knob of the one in use are choices of the key."""

    key: str
    x: str
    y: str
    limit: float = math.inf
    reason: str = ""


@attrs.frozen(eq=False)
class Subject:
    """candidates or tables: a function of the inputs. paper: what the paper does. needs: the inputs that it reads.

    Pairs are for quick and full runs. budget_s: seconds of timing. turns: minimum number of turns of each candidate.
    """

    name: str
    title: str
    question: str
    figures: tuple[Figure, ...] = ()
    charts: tuple[Chart | Profile, ...] = ()
    candidates: "Callable[[Inputs], Iterator[Candidate | Skipped]] | None" = None
    tables: "Callable[[Inputs], Iterator[Table | Skipped]] | None" = None
    paper: str = ""
    needs: tuple[str, ...] = ()
    choice: Choice | None = None
    budget_s: tuple[float, float] = (5.0, 60.0)
    turns: tuple[int, int] = (7, 15)

    def figure(self, key: str) -> Figure:
        return next(figure for figure in self.figures if figure.key == key)


@attrs.frozen
class Value:
    """A figure of a candidate. low, high: its 95 % interval, or its range if there are fewer than MIN_SAMPLES samples. turns: how
    often it was timed, 0 for an error. parts: samples within turns."""

    value: float
    low: float
    high: float
    turns: int = 0
    parts: int = 0

    @property
    def half(self) -> float:
        """Half the interval, 0 for an error."""
        return (self.high - self.low) / 2

    @property
    def text(self) -> str:
        """The number, with its interval, or the number and range of turns if there are too few for one."""
        if not self.turns:
            return short(self.value)
        if max(self.turns, self.parts) >= MIN_SAMPLES:
            return f"{short(self.value)} ± {100 * self.half / abs(self.value) if self.value else 0:.0f} %"
        return f"{short(self.value)} ({self.turns} runs, {short(self.low)} to {short(self.high)})".replace("1 runs", "1 run")


@attrs.frozen
class Row:
    """A measured candidate."""

    name: str
    curve: str
    knob: str
    paper: bool
    used: bool
    line: str
    figures: dict[str, Value]

    def value(self, key: str) -> float:
        """The figure as one number; NaN if it was not measured."""
        return self.figures[key].value if key in self.figures else math.nan


@attrs.define
class SubjectResults:
    """rows, tables: what was measured. failures: failed candidates with the reason. skipped: what does not apply.

    identity: hash of all that affects the results. about: command, inputs, start. wall_s, cpu_s: of all processes.
    """

    name: str
    identity: str = ""
    about: dict[str, str] = attrs.Factory(dict)
    rows: list[Row] = attrs.Factory(list)
    tables: list[Table] = attrs.Factory(list)
    failures: dict[str, str] = attrs.Factory(dict)
    skipped: list[Skipped] = attrs.Factory(list)
    wall_s: float = 0.0
    cpu_s: float = 0.0


def short(value: float) -> str:
    """A number in short form: 0.05, 3.2, 120, 2e-06."""
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.0e}"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def write(results: dict[str, SubjectResults], folder: Path) -> None:
    """Replaces results.json. Raises UserError if the folder cannot be written."""
    content = {"format": FORMAT, "subjects": {name: attrs.asdict(found) for name, found in results.items()}}
    part = folder / f".results.{os.getpid()}"
    try:
        part.write_text(json.dumps(content, indent=1, allow_nan=False))
        part.replace(folder / "results.json")
    except OSError as error:
        raise UserError(f"{folder}: cannot be written: {error.strerror}", "choose another folder with --out DIR") from None


def read(folder: Path) -> dict[str, SubjectResults]:
    """The results in a folder. Raises UserError if there are none, or they have another format."""
    path = folder / "results.json"
    remedy = "give a folder written by `lfpipe bench --out`"
    try:
        content = json_fields(read_bytes(path, MAX_BYTES), str(path), remedy).values
        if content.get("format") != FORMAT:
            raise UserError(f"{path}: format {content.get('format')!r:.100}; this version reads {FORMAT}", "measure again")
        return {name: _subject(values) for name, values in content["subjects"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        why = reason(error) if isinstance(error, OSError | ValueError) else f"unexpected form: {error!r:.200}"
        raise UserError(f"{path}: no results of `lfpipe bench`: {why}", remedy) from None


def _subject(values: dict[str, Any]) -> SubjectResults:
    rows = [Row(**{**row, "figures": {key: Value(**one) for key, one in row["figures"].items()}}) for row in values["rows"]]
    tables = [
        Table(one["title"], one["note"], tuple(one["head"]), tuple(tuple(Cell(**cell) for cell in row) for row in one["rows"]))
        for one in values["tables"]
    ]
    skipped = [Skipped(**one) for one in values["skipped"]]
    return SubjectResults(**{**values, "rows": rows, "tables": tables, "skipped": skipped})


def figures_of(folder: Path, name: str) -> tuple[dict[str, Any], list[str], list[str]]:
    """Figures of a subject by name, its failures, and what it left out, each with its reason. Raises UserError."""
    found = read(folder)[name]
    figures: dict[str, Any] = {f"{row.name}: {key}": one.value for row in found.rows for key, one in row.figures.items()}
    for state in ("ok", "degraded", "failed"):
        if cells := [cell for table in found.tables for row in table.rows for cell in row if cell.state and not cell.only]:
            figures[f"cells {state}"] = float(sum(cell.state == state for cell in cells))
    return figures, [f"{one}: {why}" for one, why in found.failures.items()], [f"{s.what}: {s.why}" for s in found.skipped]
