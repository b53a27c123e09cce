"""What a subject is made of: candidates with figures, drawn in diagrams, and tables of cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Literal

import attrs
import numpy as np

if TYPE_CHECKING:
    from lfpipe.bench.inputs import Inputs

State = Literal["", "ok", "degraded", "failed"]
Turn = Mapping[str, float | list[float]]


@attrs.frozen
class Figure:
    """A quantity that candidates are measured by. reduce: how its samples become one number."""

    key: str
    label: str
    unit: str
    reduce: Literal["median", "rms", "mean", "max"] = "median"
    more_is_better: bool = False

    @property
    def axis(self) -> str:
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def of(self, samples: list[float]) -> float:
        """The one number of samples; NaN where there are none."""
        if not samples:
            return float("nan")
        values = np.array(samples, np.float64)
        if self.reduce == "rms":
            return float(np.sqrt(np.mean(values**2)))
        if self.reduce == "max":
            return float(np.max(values))
        return float(np.median(values) if self.reduce == "median" else np.mean(values))


@attrs.frozen(eq=False)
class Prepared:
    """A candidate ready to be measured.

    errors: samples of each figure, measured once; the k-th sample of two builds is of the same frame, view or second. turn: one
    timed turn, a sample of each figure, or those of its parts where a turn is long; None where nothing is to be timed.
    """

    errors: Callable[[], dict[str, list[float]]]
    turn: Callable[[], Turn] | None = None
    close: Callable[[], None] = lambda: None


@attrs.frozen(eq=False)
class Candidate:
    """One point: the `curve` it lies on, the `knob` that moves it along; together its name. paper: what the paper does. line: the
    points of a curve that are joined, where its knob is more than one thing."""

    curve: str
    knob: str
    prepare: Callable[[], Prepared]
    paper: bool = False
    line: str = ""

    @property
    def name(self) -> str:
        return f"{self.curve}, {self.knob}" if self.knob else self.curve


@attrs.frozen
class Skipped:
    """What makes no sense for the inputs, and why."""

    what: str
    why: str


@attrs.frozen
class Diagram:
    """Figure y against figure x, one curve per method, both axes logarithmic; less is better on both.

    whisker: figure of the 95th percentile of x. guide: (figure, label) of a vertical line: what no method can be faster than.
    """

    name: str
    title: str
    x: str
    y: str
    whisker: str = ""
    guide: tuple[str, str] | None = None


@attrs.frozen
class Profile:
    """One line per candidate whose knob is in `knobs`: the figures of keys over their place on x. paper's line is dashed."""

    name: str
    title: str
    x_axis: str
    y_axis: str
    keys: tuple[tuple[float, str], ...]
    knobs: tuple[str, ...]


@attrs.frozen
class Cell:
    text: str
    state: State = ""


@attrs.frozen
class Table:
    """rows of cells under a head; note says what is seen."""

    title: str
    note: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@attrs.frozen(eq=False)
class Subject:
    """candidates or tables: a plain function from the inputs; `paper` names the paper's point for the report.

    budget_s: seconds of timing, quick and not; turns: the fewest turns of each candidate, quick and not.
    """

    name: str
    title: str
    question: str
    figures: tuple[Figure, ...] = ()
    diagrams: tuple[Diagram | Profile, ...] = ()
    candidates: Callable[[Inputs], Iterator[Candidate | Skipped]] | None = None
    tables: Callable[[Inputs], Iterator[Table | Skipped]] | None = None
    paper: str = ""
    budget_s: tuple[float, float] = (5.0, 60.0)
    turns: tuple[int, int] = (7, 15)

    def figure(self, key: str) -> Figure:
        return next(figure for figure in self.figures if figure.key == key)
