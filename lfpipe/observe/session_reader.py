"""Reads running sessions: attaches to their status tables untracked and read-only, without side effects."""

import json
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.host.processes import rss_bytes
from lfpipe.host.segment import WrongSegment
from lfpipe.supervisor.process_table import SHOWN_BY
from lfpipe.supervisor.rundir import find
from lfpipe.supervisor.snapshot import snapshot
from lfpipe.transport import control
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.histogram import MIDDLES_US
from lfpipe.transport.session import Session
from lfpipe.transport.status import Table

WINDOW_S = (
    10.0  # of what monitors show: long enough for a p99 at 30 Hz, short enough to see a change
)
HELLO_S = 0.5  # timeout for the settings; figures need no answer
Rows = dict[str, NDArray[np.void]]
HISTOGRAMS = ("wait", "busy", "age", "horizon")


def ask(name: str, message: dict[str, Any], timeout_s: float = 2.0) -> dict[str, Any]:
    """Sends one command to the session that has this name now; returns its answer. Raises UserError."""
    return control.request(find(name).run_dir, message, timeout_s)


class Watch:
    """One attachment. pid: of the supervisor. Raises UserError if the session ends meanwhile, or if its table has another
    version."""

    def __init__(self, session: Session) -> None:
        self.session = session
        try:
            self._about = session.run_dir / "session.json"
            self._mark = self._marked()
            about = json.loads(self._about.read_text())
            self.table = Table(session.segment("status"))
            self.started_ns, self.pid = int(about["started_ns"]), int(about["pid"])
        except WrongSegment:
            raise
        except (FileNotFoundError, ValueError):
            raise UserError(
                f"session {session.name!r} is starting or ending", "try again in a second"
            ) from None

    def read(self) -> dict[str, Any]:
        """The state since the session began, see `snapshot`."""
        return snapshot(self.session.name, self.table.rows, self.table.session, self.started_ns)

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


def _since(row: NDArray[np.void], before: NDArray[np.void]) -> NDArray[np.void]:
    """row with its histograms counted from `before` on; maxima are then the middle of their bucket (1.6 %)."""
    out = row.copy()
    for name in HISTOGRAMS:
        for field in ("count", "sum_ns", "buckets"):
            out[name][field] -= before[name][field]
        filled = np.flatnonzero(out[name]["buckets"])
        out[name]["max_ns"] = int(1e3 * MIDDLES_US[filled[-1]]) if len(filled) else 0
    return out


class Follower:
    """What monitors show of the session of a name. It detaches when the session ends and attaches to the next one.

    watch: the attachment, None without a session.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.watch: Watch | None = None
        self._past: deque[tuple[int, Rows]] = deque()  # time, and a copy of the table
        self._dropped: dict[str, int] = {}  # at the reset
        self._settings: dict[str, Any] = {}
        self._revision = -1  # of the settings

    def read(self) -> dict[str, Any] | None:
        """`snapshot` with the times of the last WINDOW_S, and more; None without a session.

        `cpu_percent`, `rss_mb`: of each stage. `config`, `options`, `paused`: see the command `hello`; missing if the session
        does not answer.
        """
        if self.watch is not None and not self.watch.living():
            self.close()
        if self.watch is None:
            try:
                self.watch = Watch(find(self.name))
            except UserError:
                return None
        t_ns, now = now_ns(), {name: row.copy() for name, row in self.watch.table.rows.items()}
        while self._past and t_ns - self._past[0][0] > WINDOW_S * SECOND_NS:
            self._past.popleft()
        self._past.append((t_ns, now))
        then_ns, then = self._past[0]
        rows = {name: _since(row, then[name]) for name, row in now.items()}
        state = snapshot(self.name, rows, self.watch.table.session, self.watch.started_ns)
        for name, stage in state["stages"].items():
            spent_ns = int(now[name]["cpu_ns"]) - int(
                then[name]["cpu_ns"]
            )  # of one process: less after a restart
            stage["cpu_percent"] = round(max(0.0, 100.0 * spent_ns / max(t_ns - then_ns, 1)), 1)
            stage["rss_mb"] = round(rss_bytes(stage["pid"]) / 1e6, 1)
            stage["dropped"] -= self._dropped.get(name, 0)
        if (revision := int(now[SHOWN_BY]["config_rev"])) != self._revision:
            try:
                answer = ask(self.name, {"cmd": "hello"}, HELLO_S)
                self._settings, self._revision = (
                    {key: answer[key] for key in ("config", "options", "paused")},
                    revision,
                )
            except UserError:
                self._settings = {}
        return {**state, **self._settings}

    def reset(self) -> None:
        """Counts drops and times from the last reading on, for this monitor only."""
        if self._past:
            self._past = deque([self._past[-1]])
            self._dropped = {name: int(row["drops"]) for name, row in self._past[0][1].items()}

    def close(self) -> None:
        """Detaches."""
        if self.watch is not None:
            self.watch.close()
        self.watch, self._revision, self._dropped = None, -1, {}
        self._past.clear()
