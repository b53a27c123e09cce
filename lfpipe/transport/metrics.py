"""Log-linear histogram on 64-bit counters that may be in shared memory: constant size, exact count,
sum and maximum.

Values are microseconds. Below 64 us each value has its own bucket; above, every power of two is
divided into 32. So the width of a bucket is at most 1/32 of its value, and the error of its middle
at most 1/64 = 1.6 % (the layout of HdrHistogram). One writer. Any process may read it at any time;
counts may then be off by one, but never corrupt.
"""

import enum
from collections.abc import Iterator
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.files.untrusted import MAX_INTEGER

LAST_OCTAVE = 26  # values to 2^32 us, 71 minutes; longer values go to the last bucket
BUCKETS = (LAST_OCTAVE << 5) + 64  # 32 an octave, after 64 of single microseconds
MAX_NS = MAX_INTEGER  # of a 64-bit counter
Times = dict[str, float]  # of `summary_ms`
HISTOGRAM = np.dtype(
    [("count", "<i8"), ("sum_ns", "<i8"), ("max_ns", "<i8"), ("buckets", "<i8", (BUCKETS,))]
)


def bucket_of(us: int) -> int:
    """Index of the bucket for us, a whole number of microseconds; negative values count as 0."""
    if us < 64:
        return max(us, 0)
    shift = us.bit_length() - 6
    return min((shift << 5) + (us >> shift), BUCKETS - 1)


def middle_us(bucket: int) -> float:
    """The value that represents a bucket."""
    if bucket < 64:
        return float(bucket)
    shift = (bucket >> 5) - 1
    low = ((bucket & 31) + 32) << shift
    return low + ((1 << shift) - 1) / 2


MIDDLES_US = np.array([middle_us(i) for i in range(BUCKETS)])


class Histogram:
    """Writer's side.

    record: a scalar view of dtype HISTOGRAM (shape ()), for example a field of a status row.
    """

    def __init__(self, record: NDArray[np.void] | None = None) -> None:
        self.record: NDArray[np.void] = np.zeros((), HISTOGRAM) if record is None else record
        self._buckets = self.record["buckets"].data
        self._head = [self.record[name].reshape(1).data for name in ("count", "sum_ns", "max_ns")]

    def add_ns(self, value_ns: int) -> None:
        """Adds one duration in nanoseconds; a negative one counts as 0.

        Sum and maximum stop at MAX_NS.
        """
        value_ns = min(max(value_ns, 0), MAX_NS)
        self._buckets[bucket_of(value_ns // 1000)] += 1
        count, total, top = self._head
        count[0] += 1
        total[0] = min(total[0] + value_ns, MAX_NS)
        if value_ns > top[0]:
            top[0] = value_ns


def quantiles(times: Times, *keys: str) -> str:
    """These keys of a summary as text, for example `p50 41.2, p95 50.1 ms`."""
    return ", ".join(f"{key.removesuffix('_ms')} {times[key]:.1f}" for key in keys) + " ms"


def summary_ms(record: NDArray[np.void]) -> Times:
    """{"n", "mean_ms", "p50_ms", "p95_ms", "p99_ms", "max_ms"} of a HISTOGRAM record; zeros if it
    is empty.

    A percentile is the middle of the bucket with the value of that rank, but never more than the
    maximum.
    """
    counts = record["buckets"].copy()
    total = int(counts.sum())
    top_ms = float(record["max_ns"]) / 1e6
    out = {"n": total, "mean_ms": round(float(record["sum_ns"]) / 1e6 / total, 4) if total else 0.0}
    ranks = np.cumsum(counts)
    for name, share in (("p50_ms", 0.50), ("p95_ms", 0.95), ("p99_ms", 0.99)):
        at = int(np.searchsorted(ranks, max(1, np.ceil(share * total)))) if total else 0
        out[name] = round(min(float(MIDDLES_US[at]) / 1e3, top_ms), 4) if total else 0.0
    out["max_ms"] = round(top_ms, 4)
    return out


# Metrics of stages: a stage declares them in its own package and stores them in its row of the
# status table; monitors list them automatically.
#
#     METRICS = MetricSet(
#         Metric("juddered", Kind.COUNT, "refreshes that showed another picture than planned"),
#         Metric("prediction", Kind.HISTOGRAM, "from the sensor stamp to the predicted eyes"),
#     )
#
# The stage's row in `supervisor/process_table.py` names the set; the stage then writes
# `context.row["juddered"] += 1` and `context.row.histograms["prediction"].add_ns(...)`.

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
