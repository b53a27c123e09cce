"""Metrics of stages: a stage declares them in its own package and stores them in its row of the
status table; monitors list them automatically.

    METRICS = MetricSet(
        Metric("juddered", Kind.COUNT, "refreshes that showed another picture than planned"),
        Metric("prediction", Kind.HISTOGRAM, "from the sensor stamp to the predicted eyes"),
    )

The stage's row in `supervisor/process_table.py` names the set; the stage then writes
`context.row["juddered"] += 1` and `context.row.histograms["prediction"].add_ns(...)`.
"""

import enum
from collections.abc import Iterator
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.transport.histogram import HISTOGRAM, Times, summary_ms

MAX_VALUES, MAX_HISTOGRAMS = 32, 2  # of one stage
SPACE = [("values", "<i8", (MAX_VALUES,)), ("histograms", HISTOGRAM, (MAX_HISTOGRAMS,))]
Value = int | float | bool | str | Times | None  # of a metric, for people and JSON


class Kind(enum.Enum):
    """The kind of a metric; all but HISTOGRAM are stored as one int64."""

    COUNT = "count"
    """Grows; survives a restart of the stage."""
    GAUGE = "gauge"
    """A current value."""
    FLAG = "flag"
    """Whether a condition holds now."""
    STATE = "state"
    """An index into the metric's states."""
    STAMP = "stamp"
    """A time of CLOCK_MONOTONIC in ns; 0: never."""
    DURATION = "duration"
    """In ns; 0: unknown. Its name ends with `_ns`."""
    HISTOGRAM = "histogram"
    """The distribution of a duration."""


@attrs.frozen
class Metric:
    """One metric of a stage."""

    name: str
    kind: Kind
    meaning: str
    """One line, with the unit of a gauge."""
    states: tuple[str, ...] = ()
    """Of the kind STATE."""

    @property
    def key(self) -> str:
        """Its name in JSON: durations are in ms there."""
        is_duration = self.kind is Kind.DURATION
        return f"{self.name.removesuffix('_ns')}_ms" if is_duration else self.name

    def shown(self, stored: Any) -> Value:
        """The value for people and JSON, from the value stored in a row."""
        if self.kind is Kind.HISTOGRAM:
            return summary_ms(stored)
        number = int(stored)
        if self.kind is Kind.FLAG:
            return bool(number)
        if self.kind is Kind.STATE:
            return self.states[number]
        if self.kind is Kind.DURATION:
            return round(number / 1e6, 2) or None
        return number


class MetricSet:
    """The metrics of one stage, in the order of their declaration. Raises ValueError if they do not
    fit the row or share a name.
    """

    def __init__(self, *metrics: Metric) -> None:
        self.histograms = tuple(one for one in metrics if one.kind is Kind.HISTOGRAM)
        self.values = tuple(one for one in metrics if one.kind is not Kind.HISTOGRAM)
        self._metrics = metrics
        if len(self.values) > MAX_VALUES or len(self.histograms) > MAX_HISTOGRAMS:
            raise ValueError(
                f"a stage has at most {MAX_VALUES} values, {MAX_HISTOGRAMS} histograms"
            )
        if len({one.name for one in metrics}) < len(metrics):
            raise ValueError("two metrics of a stage have the same name")

    def __iter__(self) -> Iterator[Metric]:
        return iter(self._metrics)

    def read(self, record: NDArray[np.void]) -> dict[str, Value]:
        """The metrics in a row of the status table, by their JSON keys."""
        stored = [*zip(self.values, record["values"], strict=False)]
        stored += [*zip(self.histograms, record["histograms"], strict=False)]
        at = {metric.name: metric.shown(value) for metric, value in stored}
        return {metric.key: at[metric.name] for metric in self}

    def to_plain(self) -> list[list[Any]]:
        """As plain values, for the head of the status table."""
        return [[one.name, one.kind.value, one.meaning, list(one.states)] for one in self]

    @classmethod
    def from_plain(cls, plain: list[list[Any]]) -> "MetricSet":
        """The reverse of `to_plain`. Raises ValueError, TypeError."""
        return cls(
            *(
                Metric(name, Kind(kind), meaning, tuple(states))
                for name, kind, meaning, states in plain
            )
        )


NO_METRICS = MetricSet()
