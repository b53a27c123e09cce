"""Reads a running session: attaches to its status table untracked and read-only, without side effects."""

import json
from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.host.processes import cpu_ns, rss_bytes
from lfpipe.supervisor.process_table import SHOWN_BY
from lfpipe.supervisor.rundir import find
from lfpipe.supervisor.snapshot import snapshot
from lfpipe.transport.clock import now_ns
from lfpipe.transport.histogram import MIDDLES_US, summary_ms
from lfpipe.transport.segment import WrongSegment
from lfpipe.transport.session import Session
from lfpipe.transport.status import Table

WINDOW_S = 10.0
HISTOGRAMS = ("wait", "busy", "age", "horizon")


class _Sample(NamedTuple):
    """A copy of the table's rows, and the CPU time of the processes."""

    t_ns: int
    rows: dict[str, NDArray[np.void]]
    cpu_ns: dict[int, int]


def since(row: NDArray[np.void], before: NDArray[np.void] | None) -> NDArray[np.void]:
    """row with its drops and histograms counted from `before` on; maxima are then the middle of their bucket (1.6 %)."""
    out = row.copy()
    if before is None:
        return out
    out["drops"] -= before["drops"]
    for name in HISTOGRAMS:
        for field in ("count", "sum_ns", "buckets"):
            out[name][field] -= before[name][field]
        filled = np.flatnonzero(out[name]["buckets"])
        out[name]["max_ns"] = int(1e3 * MIDDLES_US[filled[-1]]) if len(filled) else 0
    return out


class Watch:
    """One attachment. Raises UserError if the session ends meanwhile, or if its table has another version."""

    def __init__(self, session: Session) -> None:
        self.session = session
        try:
            self._about = session.run_dir / "session.json"
            self._mark = self._marked()
            about = json.loads(self._about.read_text())
            self.table = Table(session.segment("status"))
            self._started_ns, self._pid = int(about["started_ns"]), int(about["pid"])
        except WrongSegment:
            raise
        except (FileNotFoundError, ValueError):
            raise UserError(f"session {session.name!r} is starting or ending", "try again in a second") from None
        self._past: deque[_Sample] = deque([self._sample()])
        self._reset: dict[str, NDArray[np.void]] = {}

    def read(self) -> dict[str, Any]:
        """The current state, see `snapshot`."""
        return snapshot(self.session.name, self.table.rows, self.table.session, self._started_ns)

    def reset(self) -> None:
        """Counts drops and worst times from now on, for this monitor only."""
        self._past = deque([self._sample()])
        self._reset = self._past[0].rows

    def read_window(self) -> dict[str, Any]:
        """`snapshot` with the times of the last WINDOW_S, and more.

        `cpu_percent`, `rss_mb`: of the supervisor and of each stage. `worst_ms`: of each stage since the reset. `age_now_ms`: the
        median since the reading before, or None.
        """
        now, last = self._sample(), self._past[-1]
        while len(self._past) > 1 and now.t_ns - self._past[1].t_ns >= WINDOW_S * 1e9:
            self._past.popleft()
        then = self._past[0]
        self._past.append(now)
        since_reset = {name: since(row, self._reset.get(name)) for name, row in now.rows.items()}
        rows = {name: since(row, then.rows[name]) for name, row in now.rows.items()}
        for name, row in rows.items():
            row["drops"] = since_reset[name]["drops"]
        state = snapshot(self.session.name, rows, self.table.session, self._started_ns)
        for name, stage in state["stages"].items():
            worst_ms = float(since_reset[name]["busy"]["max_ns"]) / 1e6
            stage |= {**self._load(now, then, stage["pid"]), "worst_ms": worst_ms}
        age = summary_ms(since(now.rows[SHOWN_BY], last.rows[SHOWN_BY])["age"])
        state |= self._load(now, then, self._pid)
        state |= {"config_rev": int(now.rows[SHOWN_BY]["config_rev"]), "age_now_ms": age["p50_ms"] if age["n"] else None}
        return state

    def _sample(self) -> _Sample:
        rows = {name: row.copy() for name, row in self.table.rows.items()}
        pids = [self._pid, *(int(row["pid"]) for row in rows.values() if row["pid"])]
        return _Sample(now_ns(), rows, {pid: cpu_ns(pid) for pid in pids})

    @staticmethod
    def _load(now: _Sample, then: _Sample, pid: int) -> dict[str, float]:
        """The load of a process, over the window or since it started."""
        spent_ns = now.cpu_ns.get(pid, 0) - then.cpu_ns.get(pid, 0)
        percent = max(0.0, 100.0 * spent_ns / max(now.t_ns - then.t_ns, 1))
        return {"cpu_percent": round(percent, 1), "rss_mb": round(rss_bytes(pid) / 1e6, 1)}

    def living(self) -> bool:
        """Whether the session is still the one that was attached to."""
        try:
            return self._marked() == self._mark
        except FileNotFoundError:
            return False

    def _marked(self) -> tuple[int, int]:
        about = self._about.stat()
        return about.st_ino, about.st_mtime_ns

    def close(self) -> None:
        """Releases the table."""
        self.table.close()


class FollowingReader:
    """A watch that outlives its session: it detaches when the session ends and attaches to the next one of the same name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.watch: Watch | None = None

    def read(self) -> dict[str, Any] | None:
        """The current session, see `Watch.read_window`, or None."""
        if self.watch is not None and not self.watch.living():
            self.close()
        if self.watch is None:
            try:
                self.watch = Watch(find(self.name))
            except UserError:
                return None
        return self.watch.read_window()

    def reset(self) -> None:
        """See `Watch.reset`."""
        if self.watch is not None:
            self.watch.reset()

    def close(self) -> None:
        """Detaches."""
        if self.watch is not None:
            self.watch.close()
            self.watch = None
