"""The status table: one row per process in shared memory. The supervisor and monitors read it
without messages.

    0    magic "LFSTAT1\\0"
    8    checksum of the types below, so that a table with other fields is never misread
    16   length of the declarations: the metrics of each row as JSON
    64   declarations, then PAGE_ROWS rows of ROW, then SESSION

The fields of ROW are common to all stages. Each stage declares further metrics; the table contains
the declarations, so a reader knows the stages of any version.

A row has one writer at any time: the stage while it lives, otherwise the supervisor. Only the
supervisor writes the fields from `name` to `dead_ns`. Counters and histograms survive a restart of
the stage.

Histograms are log-linear: constant size, exact count, sum and maximum. Values are microseconds.
Below 64 us each value has its own bucket; above, every power of two is divided into 32. So the
width of a bucket is at most 1/32 of its value, and the error of its middle at most 1/64 = 1.6 %
(the layout of HdrHistogram). Any process may read one at any time; counts may then be off by one,
but never corrupt.
"""

import enum
import json
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.files.safe_files import MAX_INTEGER
from lfpipe.host.files import Segment, create_segment, publish_segment
from lfpipe.transport.ring import SLOT_HEADER, now_ns

# 26 octaves of 32, to 2^32 us (71 minutes), after 64 of single microseconds; longer values go to
# the last bucket
BUCKETS = (26 << 5) + 64
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


def _middle_us(bucket: int) -> float:
    """The value that represents a bucket: above 64 us, its middle."""
    return bucket if bucket < 64 else ((2 * (bucket % 32) + 65) * 2.0 ** (bucket // 32 - 1) - 1) / 2


MIDDLES_US = np.array([_middle_us(k) for k in range(BUCKETS)])


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

        Sum and maximum stop at MAX_INTEGER.
        """
        value_ns = min(max(value_ns, 0), MAX_INTEGER)
        self._buckets[bucket_of(value_ns // 1000)] += 1
        count, total, top = self._head
        count[0] += 1
        total[0] = min(total[0] + value_ns, MAX_INTEGER)
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
    """The metrics of one stage, in the order of their declaration: at most MAX_VALUES and
    MAX_HISTOGRAMS, of different names.
    """

    def __init__(self, *metrics: Metric) -> None:
        self.histograms = tuple(one for one in metrics if one.kind is Kind.HISTOGRAM)
        self.values = tuple(one for one in metrics if one.kind is not Kind.HISTOGRAM)
        self._metrics = metrics

    def __iter__(self) -> Iterator[Metric]:
        return iter(self._metrics)

    def read(self, record: NDArray[np.void]) -> dict[str, Value]:
        """The metrics in a row of the status table, by their JSON keys."""
        stored = [*zip(self.values, record["values"], strict=False)]
        stored += [*zip(self.histograms, record["histograms"], strict=False)]
        at = {metric.name: metric.shown(value) for metric, value in stored}
        return {metric.key: at[metric.name] for metric in self}


NO_METRICS = MetricSet()


RECENT = 64  # completion stamps kept for the rate
RINGS = 8  # maximum number of rings of a session


class State(enum.IntEnum):
    """The state of a process.

    NONE: the session never needed it. FINISHED: it completed its work.
    """

    NONE = 0
    STARTING = 1
    READY = 2
    RUNNING = 3
    STOPPING = 4
    DEAD = 5
    FINISHED = 6


ENDED = (State.NONE, State.DEAD, State.FINISHED)  # states without a process


ROW = np.dtype(
    [
        ("name", "S16"),
        ("pid", "<i8"),
        ("restarts", "<i8"),
        ("started_ns", "<i8"),
        ("dead_ns", "<i8"),
        ("state", "<i8"),
        ("ready_ns", "<i8"),
        ("beat_ns", "<i8"),  # updated only by the main loop
        ("seq", "<i8"),  # outputs completed, over all restarts
        ("source_seq", "<i8"),  # of the input last completed
        # last taken of each ring, by `StageSpec.ring_index`: the credit of lossless running
        ("taken_seq", "<i8", (RINGS,)),
        ("epoch", "<i8"),
        # files that a full disk or the like has ended early, over all restarts
        ("lost_outputs", "<i8"),
        ("drops", "<i8"),  # inputs that this stage lost, or could not use in time
        # inputs left out on purpose: at a lowered quality, while paused, for a newer one
        ("left_out", "<i8"),
        ("missed", "<i8"),  # outputs that were due on the stage's own clock but never made
        ("config_rev", "<i8"),  # revision of the session state that it uses
        ("busy_ns", "<i8"),
        ("cpu_ns", "<i8"),
        ("fault", "S96"),  # the part of the stage that does not work; empty if all do
        ("fault_since_ns", "<i8"),
        # outputs with a result while all parts worked, and those without it while one did not
        ("outputs_ok", "<i8"),
        ("outputs_faulty", "<i8"),
        ("busy_since_ns", "<i8"),  # start of the work in busy_with
        ("busy_with", "S32"),  # description of work outside its loop; empty in its loop
        ("recent_ns", "<i8", (RECENT,)),
        ("wait", HISTOGRAM),  # from publication by the previous stage until taken by this one
        ("busy", HISTOGRAM),  # from taken to published
        ("age", HISTOGRAM),  # from the sensor to publication: the output's age
        *SPACE,  # for the stage's own metrics
    ]
)
PAGE_ROWS = 16  # stages: lfpipe has seven, other packages the rest

# Of the whole session, written by the supervisor: the current level of quality (0 is full), the
# lowest level, and a description.
SESSION = np.dtype([("level", "<i8"), ("lowest", "<i8"), ("words", "S96")])

MAGIC = b"LFSTAT1\0"
MAX_DECLARED_BYTES = 16 << 10
ROWS_AT = SLOT_HEADER + MAX_DECLARED_BYTES
SIZE_BYTES = ROWS_AT + PAGE_ROWS * ROW.itemsize + SESSION.itemsize
LAYOUT = zlib.crc32(repr((ROW.descr, PAGE_ROWS, SESSION.descr)).encode())


def create(path: Path, stages: Mapping[str, MetricSet]) -> Segment:
    """An empty table with one row per stage, at most PAGE_ROWS. The caller keeps and unlinks the
    segment. Raises UserError as `create_segment` does, ValueError if
    there are too many stages or metrics.
    """
    plain = {
        stage: [[one.name, one.kind.value, one.meaning, one.states] for one in metrics]
        for stage, metrics in stages.items()
    }
    declared = json.dumps(plain).encode()
    if len(stages) > PAGE_ROWS or len(declared) > MAX_DECLARED_BYTES:
        raise ValueError(f"{len(stages)} stages with {len(declared)} bytes of metrics do not fit")
    memory = create_segment(path, SIZE_BYTES)
    buffer = memory.buf
    np.frombuffer(buffer, ROW, len(stages), ROWS_AT)["name"] = [one.encode() for one in stages]
    buffer[SLOT_HEADER : SLOT_HEADER + len(declared)] = declared
    np.frombuffer(buffer, "<i8", 2, len(MAGIC))[:] = LAYOUT, len(declared)
    buffer[: len(MAGIC)] = MAGIC
    publish_segment(memory, path)  # last: a reader that finds it finds all
    return memory


class Table:
    """An attached table. rows: name of a stage -> its record of dtype ROW, shape (). metrics: name
    of a stage -> the metrics that it declares. session: a record of dtype SESSION, shape ().

    Raises FileNotFoundError if the segment does not exist, WrongSegment if it has other contents.
    """

    def __init__(self, path: Path, writable: bool = False) -> None:
        self._memory = Segment(path)
        self._memory.check(MAGIC + LAYOUT.to_bytes(8, "little"), "status table", SIZE_BYTES)
        buffer = self._memory.buf if writable else self._memory.buf.toreadonly()
        table: NDArray[np.void] = np.frombuffer(buffer, ROW, PAGE_ROWS, ROWS_AT)
        self.session: NDArray[np.void] = np.frombuffer(
            buffer, SESSION, 1, ROWS_AT + table.nbytes
        ).reshape(())
        self.rows = {
            bytes(table[i]["name"]).decode(): table[i : i + 1].reshape(())
            for i in range(PAGE_ROWS)
            if table[i]["name"]
        }
        size = int(np.frombuffer(buffer, "<i8", 1, 2 * len(MAGIC))[0])
        declared = json.loads(bytes(buffer[SLOT_HEADER : SLOT_HEADER + size]))
        self.metrics = {
            stage: MetricSet(
                *(
                    Metric(name, Kind(kind), meaning, tuple(states))
                    for name, kind, meaning, states in declared[stage]
                )
            )
            for stage in self.rows
        }

    def close(self) -> None:
        """Drops the views, then the mapping."""
        self.rows.clear()
        del self.session
        self._memory.close()


class Row:
    """A stage's access to its row: integers by name, and histograms. metrics: those that the stage
    declares.
    """

    def __init__(self, record: NDArray[np.void], metrics: MetricSet = NO_METRICS) -> None:
        self.record = record
        self._int = {
            name: record[name].reshape(1).data
            for name in ROW.names or ()
            if ROW[name] == np.dtype("<i8")
        }
        values = record["values"]
        self._int |= {
            metric.name: values[at : at + 1].data for at, metric in enumerate(metrics.values)
        }
        self._recent = record["recent_ns"].data
        self.wait, self.busy, self.age = (
            Histogram(record[name]) for name in ("wait", "busy", "age")
        )
        self.histograms = {
            metric.name: Histogram(record["histograms"][at : at + 1].reshape(()))
            for at, metric in enumerate(metrics.histograms)
        }

    def __getitem__(self, name: str) -> int:
        return self._int[name][0]

    def __setitem__(self, name: str, value: int) -> None:
        self._int[name][0] = value

    def heartbeat(self) -> None:
        """Reports that the stage is alive and its loop is running."""
        self._int["beat_ns"][0] = now_ns()

    def set_busy(self, work: str) -> None:
        """Sets the stage's current work outside its loop, at most 32 bytes; "" to clear it."""
        self._int["busy_since_ns"][0] = self._int["beat_ns"][0] = now_ns()
        self.record["busy_with"] = work.encode()

    def report_health(self, fault: str, has_result: bool) -> None:
        """Counts an output. fault: the part of the stage that does not work, at most 96 bytes; ""
        if there is none.
        """
        self._int["outputs_faulty" if fault else "outputs_ok"][0] += bool(fault) or has_result
        data = fault.encode()[:96]
        if data != self.record["fault"].item():
            self._int["fault_since_ns"][0] = now_ns()
            self.record["fault"] = data

    def count_output(self, source_seq: int) -> None:
        """Counts one completed output, made from input source_seq."""
        t_ns = now_ns()
        seq = self._int["seq"][0]
        self._recent[seq % RECENT] = t_ns
        self._int["seq"][0] = seq + 1
        self._int["source_seq"][0] = source_seq
        self._int["beat_ns"][0] = t_ns

    def record_latency(self, wait_ns: int, busy_ns: int, age_ns: int | None) -> None:
        """Records the three durations of one output.

        age_ns: None for a picture that was never shown.
        """
        self._int["busy_ns"][0] += busy_ns
        self.wait.add_ns(wait_ns)
        self.busy.add_ns(busy_ns)
        if age_ns is not None:
            self.age.add_ns(age_ns)


def clear(record: NDArray[np.void], *names: str) -> None:
    """Sets fields of a row to 0 or to empty text."""
    for name in names:
        record[name] = np.zeros((), ROW[name])


def busy_work(record: NDArray[np.void]) -> str:
    """A stage's current work outside its loop; "" if none."""
    work: bytes = record["busy_with"].item()
    return work.decode(errors="replace")


def rate_hz(record: NDArray[np.void], t_ns: int | None = None) -> float:
    """Outputs per second over the last RECENT of them; 0 before two outputs, or if the newest is
    older than ten periods.
    """
    stamps = np.sort(record["recent_ns"][record["recent_ns"] > 0])
    if stamps.size < 2:
        return 0.0
    period_ns = float(stamps[-1] - stamps[0]) / (stamps.size - 1)
    stale = (now_ns() if t_ns is None else t_ns) - int(stamps[-1]) > max(10 * period_ns, 1e9)
    return 0.0 if stale or period_ns <= 0 else 1e9 / period_ns
