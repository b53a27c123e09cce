"""Reads running sessions: attaches to their status tables untracked and read-only, without side
effects.
"""

from collections import deque

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Snapshot, converter
from lfpipe.errors import UserError
from lfpipe.host.files import WrongSegment
from lfpipe.host.worker import rss_bytes
from lfpipe.supervisor.metrics import SessionMetrics, session_metrics
from lfpipe.supervisor.process_table import SHOWN_BY
from lfpipe.supervisor.rundir import ask, find
from lfpipe.transport.control import MANIFEST, Session, SessionManifest
from lfpipe.transport.ring import SECOND_NS, now_ns
from lfpipe.transport.status import MIDDLES_US, Table

# of the metrics in monitors: long enough for a p99 at 30 Hz, short enough to show changes
WINDOW_S = 10.0
HELLO_S = 0.5  # timeout for the settings; metrics need no answer
Rows = dict[str, NDArray[np.void]]
HISTOGRAMS = ("wait", "busy", "age", "histograms")


def snapshot(name: str, timeout_s: float = 2.0) -> Snapshot:
    """The settings in use in the session of that name. Raises UserError."""
    return converter().structure(ask(name, {"cmd": "hello"}, timeout_s), Snapshot)


class Watch:
    """An attachment to a session, with its manifest and table. Raises UserError if it ends
    meanwhile, or if its table has another version.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        try:
            self._mark = self._marked()
            self.manifest = SessionManifest.read(session.run_dir)
            self.table = Table(session.segment("status"))
        except WrongSegment:
            raise
        except (FileNotFoundError, ValueError):
            raise UserError(
                f"session {session.name!r} is starting or ending", "try again in a second"
            ) from None

    def read(self, rows: Rows | None = None) -> SessionMetrics:
        """The metrics since the session began, or those in a copy of the table's rows."""
        return session_metrics(
            self.session.name,
            self.table.rows if rows is None else rows,
            self.table.metrics,
            self.table.session,
            self.manifest.started_ns,
        )

    def is_running(self) -> bool:
        """Whether the session is still the one that was attached to."""
        try:
            return self._marked() == self._mark
        except FileNotFoundError:
            return False

    def _marked(self) -> tuple[int, int]:
        entry = (self.session.run_dir / MANIFEST).stat()
        return entry.st_ino, entry.st_mtime_ns

    def close(self) -> None:
        """Releases the table."""
        self.table.close()


def _since(row: NDArray[np.void], before: NDArray[np.void]) -> NDArray[np.void]:
    """row with its histograms counted from `before` on; maxima are then the middle of their bucket
    (1.6 %).
    """
    out = row.copy()
    for name in HISTOGRAMS:
        for field in ("count", "sum_ns", "buckets"):
            out[name][field] -= before[name][field]
        for histogram in np.atleast_1d(out[name]):
            filled = np.flatnonzero(histogram["buckets"])
            histogram["max_ns"] = int(1e3 * MIDDLES_US[filled[-1]]) if len(filled) else 0
    return out


@attrs.frozen
class Sample:
    """A session at one time."""

    metrics: SessionMetrics
    settings: Snapshot | None = None
    """None if the session does not answer."""


class Follower:
    """Reads the session with a given name for monitors. It detaches when the session ends, and
    attaches to the next one of that name.

    watch: the attachment; None without a session.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.watch: Watch | None = None
        self._past: deque[tuple[int, Rows]] = deque()  # time, and a copy of the table
        self._dropped: dict[str, int] = {}  # at the reset
        self._settings: Snapshot | None = None
        self._revision = -1  # of the settings

    def read(self) -> Sample | None:
        """The metrics with the times of the last WINDOW_S, and the settings; None without a
        session.
        """
        if self.watch is not None and not self.watch.is_running():
            self.close()
        if self.watch is None:
            try:
                self.watch = Watch(find(self.name))
            except UserError:
                return None
        t_ns = now_ns()
        now = {name: row.copy() for name, row in self.watch.table.rows.items()}
        while self._past and t_ns - self._past[0][0] > WINDOW_S * SECOND_NS:
            self._past.popleft()
        self._past.append((t_ns, now))
        then_ns, then = self._past[0]
        metrics = self.watch.read({name: _since(row, then[name]) for name, row in now.items()})
        stages = {}
        for name, stage in metrics.stages.items():
            # of one process: less after a restart
            spent_ns = int(now[name]["cpu_ns"]) - int(then[name]["cpu_ns"])
            stages[name] = attrs.evolve(
                stage,
                cpu_percent=round(max(0.0, 100.0 * spent_ns / max(t_ns - then_ns, 1)), 1),
                rss_mb=round(rss_bytes(stage.pid) / 1e6, 1),
                dropped=stage.dropped - self._dropped.get(name, 0),
            )
        if (revision := int(now[SHOWN_BY]["config_rev"])) != self._revision:
            try:
                self._settings = snapshot(self.name, HELLO_S)
                self._revision = revision
            except UserError:
                self._settings = None
        return Sample(attrs.evolve(metrics, stages=stages), self._settings)

    def reset(self) -> None:
        """Restarts the counts of drops and times at the last reading, for this monitor only."""
        if self._past:
            self._past = deque([self._past[-1]])
            self._dropped = {name: int(row["drops"]) for name, row in self._past[0][1].items()}

    def close(self) -> None:
        """Detaches."""
        if self.watch is not None:
            self.watch.close()
        self.watch = None
        self._revision = -1
        self._dropped = {}
        self._past.clear()
