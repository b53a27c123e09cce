"""The status table: one row per process in shared memory. The supervisor and monitors read it
without messages.

    0    magic "LFSTAT1\0"
    8    checksum of the types below, so that a table with other fields is never misread
    16   length of the declarations: the metrics of each row as JSON
    64   declarations, then PAGE_ROWS rows of ROW, then SESSION

The fields of ROW are common to all stages. Each stage declares further metrics (`metrics.py`); the
table contains the declarations, so a reader knows the stages of any version.

A row has one writer at any time: the stage while it lives, otherwise the supervisor. Only the
supervisor writes the fields from `name` to `dead_ns`. Counters and histograms survive a restart of
the stage.
"""

import enum
import json
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.host import segment
from lfpipe.host.segment import Segment
from lfpipe.transport.clock import now_ns
from lfpipe.transport.metrics import HISTOGRAM, NO_METRICS, SPACE, Histogram, MetricSet

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
HEAD = 64  # a cache line
MAX_DECLARED_BYTES = 16 << 10
ROWS_AT = HEAD + MAX_DECLARED_BYTES
SIZE_BYTES = ROWS_AT + PAGE_ROWS * ROW.itemsize + SESSION.itemsize
LAYOUT = zlib.crc32(repr((ROW.descr, PAGE_ROWS, SESSION.descr)).encode())


def create(path: Path, stages: Mapping[str, MetricSet]) -> Segment:
    """An empty table with one row per stage, at most PAGE_ROWS. The caller keeps and unlinks the
    segment. Raises UserError as `segment.create` does, ValueError if
    there are too many stages or metrics.
    """
    declared = json.dumps({stage: metrics.to_plain() for stage, metrics in stages.items()}).encode()
    if len(stages) > PAGE_ROWS or len(declared) > MAX_DECLARED_BYTES:
        raise ValueError(f"{len(stages)} stages with {len(declared)} bytes of metrics do not fit")
    memory = segment.create(path, SIZE_BYTES)
    buffer = memory.buf
    table = np.frombuffer(buffer, ROW, PAGE_ROWS, ROWS_AT)
    table["name"][: len(stages)] = [stage.encode() for stage in stages]
    buffer[HEAD : HEAD + len(declared)] = declared
    np.frombuffer(buffer, "<i8", 2, len(MAGIC))[:] = LAYOUT, len(declared)
    buffer[: len(MAGIC)] = MAGIC
    segment.publish(memory, path)  # last: a reader that finds it finds all
    return memory


class Table:
    """An attached table.

    Raises FileNotFoundError if the segment does not exist, WrongSegment if it has other contents.
    """

    rows: dict[str, NDArray[np.void]]
    """Name of a stage -> its record of dtype ROW, shape ()."""
    metrics: dict[str, MetricSet]
    """Name of a stage -> the metrics that it declares."""
    session: NDArray[np.void]
    """A record of dtype SESSION, shape ()."""

    def __init__(self, path: Path, writable: bool = False) -> None:
        self._memory = Segment(path)
        self._memory.check(MAGIC + LAYOUT.to_bytes(8, "little"), "status table", SIZE_BYTES)
        buffer = self._memory.buf if writable else self._memory.buf.toreadonly()
        table: NDArray[np.void] = np.frombuffer(buffer, ROW, PAGE_ROWS, ROWS_AT)
        self.session = np.frombuffer(buffer, SESSION, 1, ROWS_AT + table.nbytes).reshape(())
        self.rows = {
            bytes(table[i]["name"]).decode(): table[i : i + 1].reshape(())
            for i in range(PAGE_ROWS)
            if table[i]["name"]
        }
        size = int(np.frombuffer(buffer, "<i8", 1, 2 * len(MAGIC))[0])
        declared = json.loads(bytes(buffer[HEAD : HEAD + size]))
        self.metrics = {stage: MetricSet.from_plain(declared[stage]) for stage in self.rows}

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
