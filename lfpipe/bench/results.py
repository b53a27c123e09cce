"""The common format of all results: tables of rows, to be printed, drawn, judged, saved or
compared.
"""

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, TypeVar

import attrs
import cattrs
import numpy as np
from numpy.typing import ArrayLike

from lfpipe.errors import UserError
from lfpipe.files.safe_files import json_fields, read_bytes, write_output

FORMAT = "lfpipe-bench-8"
MAX_BYTES = 16 << 20  # of results.json; a full run of all benchmarks writes 0.2 MB
Metrics = dict[str, float]  # by the key of a column
RESAMPLED = 2000  # rounds of resampling for the interval of an error
MIN_ROUNDS = 5  # repetitions for an interval of the median
R = TypeVar("R")
C = TypeVar("C")
State = Literal["", "ok", "degraded", "failed"]
STATES: tuple[State, ...] = ("ok", "degraded", "failed")


@attrs.frozen
class Column:
    """A quantity."""

    key: str
    label: str
    unit: str = ""

    @property
    def axis(self) -> str:
        return f"{self.label}, {self.unit}" if self.unit else self.label


@attrs.frozen
class Value:
    """A cell of a table."""

    value: float = 0.0
    low: float = attrs.Factory(lambda self: self.value, takes_self=True)
    high: float = attrs.Factory(lambda self: self.value, takes_self=True)
    """95 % interval, or the range of few repetitions; the value itself if none is known."""
    words: str = ""
    """Text instead of the number."""
    state: State = ""
    only: str = ""
    """The setting that reaches the value; "": reached with the default settings."""

    @property
    def text(self) -> str:
        if self.words or self.low == self.high:
            return self.words or short(self.value)
        return f"{short(self.value)} ({short(self.low)} to {short(self.high)})"


@attrs.frozen
class Row:
    """A measured method (a point in a chart), or a case."""

    name: str
    values: dict[str, Value]
    curve: str = ""
    """Its curve in the chart."""
    parameter: str = ""
    """The setting that varies along the curve."""
    paper: bool = False
    """Whether this is the paper's method."""
    used: bool = False
    """Whether this is lfpipe's default."""
    samples: tuple[Metrics, ...] = ()
    """The metrics of every repetition, in execution order."""

    def value(self, key: str) -> float:
        """A metric as one number; NaN if it was not measured."""
        return self.values[key].value if key in self.values else math.nan


@attrs.frozen
class Table:
    """Rows of values by column."""

    of: str
    """The kind of the rows."""
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    title: str = ""
    note: str = ""
    """Explains the values."""

    @property
    def filled(self) -> list[Column]:
        """The columns that have values."""
        return [
            column for column in self.columns if any(column.key in row.values for row in self.rows)
        ]

    def texts(self) -> tuple[list[str], list[list[str]]]:
        """(head, body) of the filled columns; ■ marks what is in use, ★ the paper."""
        columns = self.filled
        body = [
            [
                row.name + " ■" * row.used + " ★" * row.paper,
                *(
                    row.values[column.key].text if column.key in row.values else ""
                    for column in columns
                ),
            ]
            for row in self.rows
        ]
        return [self.of, *(column.axis for column in columns)], body

    def markdown(self) -> str:
        head, body = self.texts()
        lines = [
            " | ".join(text.replace("|", " ") for text in row)
            for row in (head, ["---"] * len(head), *body)
        ]
        return "\n".join(f"| {line} |" for line in lines)

    def csv(self) -> str:
        """One line per row, three columns per quantity: value, low, high."""
        columns = self.filled
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        heads = (f"{column.axis}{end}" for column in columns for end in ("", ", low", ", high"))
        writer.writerow([self.of, "default", "paper", *heads])
        for row in self.rows:
            cells: list[object] = [row.name, int(row.used), int(row.paper)]
            for column in columns:
                value = row.values.get(column.key)
                if value is None or (value.words and value.low == value.high):
                    cells += [value and value.words, "", ""]
                else:
                    cells += [value.value, value.low, value.high]
            writer.writerow(cells)
        return out.getvalue()


def judged_table(
    title: str,
    note: str,
    of: str,
    rows: Mapping[str, R],
    columns: Mapping[str, C],
    judge: Callable[[R, C], tuple[str, State]],
    only: Callable[[R, C], str] = lambda _row, _column: "",
) -> Table:
    """A table of judged values, by the names of rows and columns. of: the kind of the rows. judge:
    returns text and state; an exception counts as failed. only: the setting that reaches the value.
    """

    def value(row: R, column: C) -> Value:
        try:
            words, state = judge(row, column)
        except Exception as error:  # the exception is the result
            words = f"{type(error).__name__}: {error}"[:80]
            state = "failed"
        return Value(words=words, state=state, only=only(row, column))

    body = (
        Row(name, {one: value(row, column) for one, column in columns.items()})
        for name, row in rows.items()
    )
    return Table(of, tuple(Column(name, name) for name in columns), tuple(body), title, note)


def judged_error(worst: float, ok: float, degraded: float) -> tuple[str, State]:
    """The worst error as text, and its state: ok up to `ok`, degraded up to `degraded`, failed
    above and for NaN.
    """
    state: State = "degraded" if worst <= degraded else "failed"
    return f"{worst:.1e}" if worst else "0", "ok" if worst <= ok else state


@attrs.define
class Results:
    """Results of one benchmark."""

    name: str
    tables: list[Table] = attrs.Factory(list)
    failures: dict[str, str] = attrs.Factory(dict)
    """Methods that raised an exception, with the reason."""
    left_out: list[str] = attrs.Factory(list)
    """Omitted measurements, with the reason."""
    about: dict[str, str] = attrs.Factory(dict)
    """Command, inputs, start."""
    wall_s: float = 0.0
    """Of the whole run."""

    @property
    def rows(self) -> list[Row]:
        """The measured methods."""
        return [row for table in self.tables for row in table.rows if row.curve]

    def judged(self) -> Iterator[tuple[Table, Row, str, Value]]:
        """(table, row, column, value) of every judged value."""
        for table in self.tables:
            for row in table.rows:
                yield from (
                    (table, row, key, value) for key, value in row.values.items() if value.state
                )


def rms(values: ArrayLike) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def timing(samples: Sequence[float]) -> Value:
    """The median with its 95 % interval by order statistics, for any distribution; for fewer
    samples than MIN_ROUNDS, which have no such interval, with the range.
    """
    ordered = sorted(samples)
    n = len(samples)
    tail = np.cumsum([math.comb(n, k) / 2**n for k in range(n // 2)])
    rank = max(1, int(np.searchsorted(tail, 0.025, side="right")))
    value = Value(float(np.median(ordered)), ordered[rank - 1], ordered[n - rank])
    if n >= MIN_ROUNDS:
        return value
    words = (short(number) for number in (value.value, value.low, value.high))
    return attrs.evolve(value, words="{} ({} to {}, range of {})".format(*words, n))


def mean_of(samples: Sequence[float], power: int = 1) -> Value:
    """The mean with its 95 % interval, by resampling. power: 2 for the root of the mean square."""
    values = np.power(samples, power, dtype=np.float64)
    drawn = np.random.default_rng(1).choice(values, (RESAMPLED, len(values)))
    means = drawn.mean(axis=-1) ** (1 / power)
    low, high = np.percentile(means, (2.5, 97.5)).tolist()
    return Value(float(values.mean() ** (1 / power)), low, high)


def ratio_of(samples: Sequence[float], base: Sequence[float]) -> Value:
    """The geometric mean of samples / base with its 95 % interval, by resampling of the pairs. All
    values must be > 0.
    """
    value = mean_of(np.log(np.divide(samples, base)).tolist())
    return Value(math.exp(value.value), math.exp(value.low), math.exp(value.high))


def range_of(samples: Sequence[float]) -> Value:
    """The mean, and the range."""
    return Value(float(np.mean(samples)), min(samples), max(samples))


def short(value: float) -> str:
    """A number in three digits: 0.05, 3.2, 41.8, 120, 1234, 2e-06."""
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.0e}"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def write(results: dict[str, Results], folder: Path) -> None:
    """Replaces results.json. Raises UserError if the folder cannot be written."""
    content = {
        "format": FORMAT,
        "benchmarks": {name: attrs.asdict(one) for name, one in results.items()},
    }
    write_output(
        folder / "results.json",
        json.dumps(content, indent=1, allow_nan=False).encode(),
        label="--out",
    )


def read(folder: Path) -> dict[str, Results]:
    """The results in a folder. Raises UserError if there are none, or they have another format."""
    path = folder / "results.json"
    remedy = "give a folder written by `lfpipe bench --out` of this version"
    try:
        content = json_fields(read_bytes(path, MAX_BYTES), str(path), remedy).values
        if content.get("format") != FORMAT:
            raise ValueError(f"format {content.get('format')!r:.100}, expected {FORMAT}")
        return cattrs.structure(content["benchmarks"], dict[str, Results])
    except (OSError, ValueError, KeyError, cattrs.BaseValidationError) as error:
        raise UserError(
            f"{path}: contains no results of `lfpipe bench`: {error!s:.200}", remedy
        ) from None
