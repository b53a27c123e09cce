"""Rates, times and load of a session over the last seconds, from the status table and the operating system."""

from collections import deque

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.processes import cpu_ns, rss_bytes, scheduling
from lfpipe.supervisor.process_table import SHOWN_BY, SOURCE, TRACKED_BY
from lfpipe.supervisor.snapshot import busy, judder_percent, light, motion_to_photon, photon_words, quality, viewer
from lfpipe.transport.clock import now_ns
from lfpipe.transport.histogram import MIDDLES_US
from lfpipe.transport.status import State, Table, rate_hz

WINDOW_S = 10.0
KINDS = ("wait", "busy", "age", "horizon")
_SHARES = np.array([0.5, 0.95, 0.99, 1.0])
_MIDDLES_MS = np.array([round(float(middle) / 1e3, 3) for middle in MIDDLES_US])

Counts = NDArray[np.int64]


@attrs.frozen
class Times:
    """Durations within a window in ms; zeros if nothing was counted."""

    n: int = 0
    p50_ms: float = 0.0
    p95_ms: float = 0.0
    p99_ms: float = 0.0
    max_ms: float = 0.0


@attrs.frozen(eq=False)
class StageReading:
    """A stage now. wait, busy: of the last seconds. busy_counts: histogram since the last reset, on MIDDLES_US. cpus: cores that
    it may run on."""

    name: str
    state: str
    busy_with: str
    pid: int
    rate_hz: float
    dropped: int
    restarts: int
    cpu_percent: float
    rss_mb: float
    cpus: tuple[int, ...]
    nice: int
    wait: Times
    busy: Times
    worst: Times
    busy_counts: Counts


@attrs.frozen(eq=False)
class Reading:
    """A session now. viewer: state of the viewer, in a word. age: of the picture when presented, over the last seconds; worst:
    since the reset; age_now_ms: since the previous reading, None if no picture was composed. horizon: time from the sensor's
    stamp to the predicted eyes. judder_percent: see `snapshot`. motion_to_photon: its latencies in words. level: of quality, 0
    for full; lowest_level: the last one; level_words: what is reduced, in words. supervisor: (CPU %, RSS in MB)."""

    uptime_s: float
    camera_hz: float
    camera_light: str
    viewer: str
    face: bool
    config_rev: int
    level: int
    lowest_level: int
    level_words: str
    stages: tuple[StageReading, ...]
    age: Times
    worst: Times
    horizon: Times
    judder_percent: float | None
    motion_to_photon: str
    age_now_ms: float | None
    supervisor: tuple[float, float]

    def stage(self, name: str) -> StageReading:
        """The stage of that name."""
        return next(stage for stage in self.stages if stage.name == name)


@attrs.frozen(eq=False)
class _Moment:
    t_ns: int
    counts: dict[tuple[str, str], Counts]
    cpu_ns: dict[int, int]
    drops: dict[str, int]


def times(counts: Counts) -> Times:
    """Quantiles of a histogram on MIDDLES_US, each the middle of its bucket (1.6 % at most from the truth)."""
    ranks = np.cumsum(counts)
    total = int(ranks[-1])
    if total <= 0:
        return Times()
    at = np.searchsorted(ranks, np.maximum(1, np.ceil(_SHARES * total)).astype(np.int64))
    return Times(total, *_MIDDLES_MS[at].tolist())


class Meter:
    """Reads a table at any pace. The window is the time between the reading of WINDOW_S ago and now."""

    def __init__(self, table: Table, started_ns: int, supervisor_pid: int) -> None:
        self._table, self._started_ns, self._supervisor_pid = table, started_ns, supervisor_pid
        self._past: deque[_Moment] = deque([self._moment()])
        self._zero: _Moment | None = None  # None: count from the start of the session

    def reset(self) -> None:
        """Resets worst times, histograms and drops, for this monitor only."""
        self._past = deque([self._moment()])
        self._zero = self._past[0]

    def _moment(self) -> _Moment:
        rows = self._table.rows
        pids = [self._supervisor_pid, *(int(row["pid"]) for row in rows.values() if row["pid"])]
        return _Moment(
            now_ns(),
            {(name, kind): row[kind]["buckets"].copy() for name, row in rows.items() for kind in KINDS},
            {pid: cpu_ns(pid) for pid in pids},
            {name: int(row["drops"]) for name, row in rows.items()},
        )

    def read(self) -> Reading:
        """The session now."""
        now, last = self._moment(), self._past[-1]
        while len(self._past) > 1 and now.t_ns - self._past[1].t_ns >= WINDOW_S * 1e9:
            self._past.popleft()
        then = self._past[0]
        self._past.append(now)
        render = self._table.rows[SHOWN_BY]
        age_now = times(now.counts[SHOWN_BY, "age"] - last.counts[SHOWN_BY, "age"])
        return Reading(
            uptime_s=(now.t_ns - self._started_ns) / 1e9,
            camera_hz=rate_hz(self._table.rows[SOURCE]),
            camera_light=light(self._table),
            viewer=viewer(self._table),
            face=bool(self._table.rows[TRACKED_BY]["face"]),
            config_rev=int(render["config_rev"]),
            **quality(self._table),
            stages=tuple(self._stage(name, row, now, then) for name, row in self._table.rows.items() if row["state"]),
            age=times(now.counts[SHOWN_BY, "age"] - then.counts[SHOWN_BY, "age"]),
            worst=times(self._since_zero(now, SHOWN_BY, "age")),
            horizon=times(now.counts[SHOWN_BY, "horizon"] - then.counts[SHOWN_BY, "horizon"]),
            judder_percent=judder_percent(render),
            motion_to_photon=photon_words(motion_to_photon(render)),
            age_now_ms=age_now.p50_ms if age_now.n else None,
            supervisor=(self._cpu(now, then, self._supervisor_pid), rss_bytes(self._supervisor_pid) / 1e6),
        )

    def _since_zero(self, now: _Moment, name: str, kind: str) -> Counts:
        counts = now.counts[name, kind]
        return counts if self._zero is None else counts - self._zero.counts[name, kind]

    @staticmethod
    def _cpu(now: _Moment, then: _Moment, pid: int) -> float:
        """CPU of a process in % of a core, over the window or since the process started."""
        spent_ns = now.cpu_ns.get(pid, 0) - then.cpu_ns.get(pid, 0)
        return max(0.0, 100.0 * spent_ns / max(now.t_ns - then.t_ns, 1))

    def _stage(self, name: str, row: NDArray[np.void], now: _Moment, then: _Moment) -> StageReading:
        pid, dropped = int(row["pid"]), now.drops[name]
        busy_counts = self._since_zero(now, name, "busy")
        cores, nice = scheduling(pid)
        return StageReading(
            name=name,
            state=State(int(row["state"])).name,
            busy_with=busy(row),
            pid=pid,
            rate_hz=rate_hz(row),
            dropped=dropped if self._zero is None else dropped - self._zero.drops[name],
            restarts=int(row["restarts"]),
            cpu_percent=self._cpu(now, then, pid),
            rss_mb=rss_bytes(pid) / 1e6,
            cpus=tuple(cores),
            nice=nice,
            wait=times(now.counts[name, "wait"] - then.counts[name, "wait"]),
            busy=times(now.counts[name, "busy"] - then.counts[name, "busy"]),
            worst=times(busy_counts),
            busy_counts=busy_counts,
        )
