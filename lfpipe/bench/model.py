"""Parts of a subject: candidates with figures, drawn in diagrams, and tables of cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Literal

import attrs
import numpy as np

if TYPE_CHECKING:
    from lfpipe.bench.inputs import Inputs

State = Literal["", "ok", "degraded", "failed"]
Samples = dict[str, list[float]]  # by the key of a figure
Turn = Mapping[str, float | list[float]]


@attrs.frozen
class Figure:
    """A measured quantity. reduce: how samples become one number."""

    key: str
    label: str
    unit: str
    reduce: Literal["median", "rms", "mean", "max"] = "median"
    more_is_better: bool = False

    @property
    def axis(self) -> str:
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def of(self, samples: list[float]) -> float:
        """The samples as one number; NaN if there are none."""
        if not samples:
            return float("nan")
        if self.reduce == "rms":
            return float(np.sqrt(np.mean(np.square(samples))))
        if self.reduce == "max":
            return max(samples)
        return float(np.median(samples) if self.reduce == "median" else np.mean(samples))


@attrs.frozen(eq=False)
class Prepared:
    """A candidate ready to be measured.

    errors: samples of each figure, measured once; sample k of two builds is of the same frame, view or second. turn: one timed
    turn with one sample per figure, or with the samples of its parts if a turn is long; None if nothing is timed.
    """

    errors: Callable[[], Samples]
    turn: Callable[[], Turn] | None = None
    close: Callable[[], None] = lambda: None


@attrs.frozen(eq=False)
class Candidate:
    """One point of a diagram, named by its curve and knob (the setting that varies along the curve).

    paper: this is what the paper does. line: points with the same line are joined, if a curve has more than one setting.
    """

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
    """An omitted measurement and the reason: it does not apply to the inputs, or --quick saves its time."""

    what: str
    why: str

    @property
    def for_speed(self) -> bool:
        """Whether a run without --quick includes it."""
        return self.why.startswith("--quick")


@attrs.frozen
class Diagram:
    """Work and precision of all candidates: keys of the figures on both axes, logarithmic, less is better.

    whisker: figure of the 95th percentile of x. guide: (figure, label) of a vertical line, a lower bound of x.
    """

    name: str
    title: str
    x: str
    y: str
    whisker: str = ""
    guide: tuple[str, str] | None = None


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
class Cell:
    text: str
    state: State = ""


@attrs.frozen
class Table:
    """Rows of cells under a head. note: explains the cells."""

    title: str
    note: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@attrs.frozen(eq=False)
class Subject:
    """candidates or tables: a function of the inputs. paper: what the paper does, for the report.

    Pairs are for quick and full runs. budget_s: seconds of timing. turns: minimum number of turns of each candidate.
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
