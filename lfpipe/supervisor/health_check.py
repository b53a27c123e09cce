"""Decides when a stage counts as hung: by its beat, a limit for its start, and what it says that it is busy with.

Running: no beat for hang_timeout_s, or COMPUTING times as long while it computes, because a slow machine is no hang. Setting up
(from its start to READY, and within `Context.setting_up`): nothing computed for startup_timeout_s. Within `busy_with` and
`saving`, around calls that may wait for a disk, or in the kernel's wait for one: nothing computed for STALL_S. In every phase:
LONGEST_S without a beat. Stopping otherwise: see `StageProcesses.stop`.

A gap of ASLEEP_S between two checks does not count: the machine was suspended, or starved all processes alike.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lfpipe.host.processes import activity
from lfpipe.supervisor.process_table import Stage
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.status import State, busy_words

ASLEEP_S = 1.0  # after such a gap between checks, the supervisor was stopped or starved, probably like the stages
STALL_S = 60.0  # time for a disk to spin up, or for a network to return
LONGEST_S = 600.0  # of continuous computing: imports and tables of a large scene on an emulated machine
COMPUTING = 5  # hang timeouts of computing without a beat: on an emulated machine one search for a face takes seconds
WORKS_SHARE = 0.01  # of the time on a CPU: more than polling a timer takes, less than a share beside dozens of busy programs
LOOK_NS = 500 * MS_NS  # between two looks at a silent process


class HealthCheck:
    """The health of one process. row: its record of the status table. look: returns ns of CPU time so far, and whether the
    process waits for a disk."""

    def __init__(self, stage: Stage, row: NDArray[np.void], pid: int, look: Callable[[int], tuple[int, bool]] = activity) -> None:
        self._stage, self._row, self._pid, self._look = stage, row, pid, look
        self._checked_ns = self._excused_ns = self._worked_ns = self._looked_ns = now_ns()
        self._sign_ns = self._cpu_ns = 0
        self._on_disk = False

    def problem(self) -> str:
        """Why the process counts as hung, or "". Call often."""
        row, t_ns = self._row, now_ns()
        if t_ns - self._checked_ns > ASLEEP_S * 1e9:
            self._excused_ns = t_ns
        self._checked_ns = t_ns
        words, stage = busy_words(row), self._stage
        if row["state"] == State.STOPPING and not words:
            return ""
        sign_ns = max(int(row[name]) for name in ("beat_ns", "started_ns", "ready_ns", "busy_since_ns"))
        sign_ns = max(sign_ns, self._excused_ns)
        if sign_ns != self._sign_ns:
            self._sign_ns = self._worked_ns = self._looked_ns = sign_ns
            self._cpu_ns, self._on_disk = -1, False
        silent_s = (t_ns - sign_ns) / 1e9
        if t_ns - self._looked_ns >= LOOK_NS:
            self._take_look(t_ns)
        sets_up = row["state"] == State.STARTING or not row["ready_ns"]
        limit_s = LONGEST_S if sets_up or words or self._on_disk else COMPUTING * stage.hang_timeout_s
        idle_limit_s = stage.startup_timeout_s if sets_up else STALL_S if words else stage.hang_timeout_s
        idle_limit_s = STALL_S if self._on_disk else idle_limit_s
        idle_s = (t_ns - self._worked_ns) / 1e9
        if idle_s <= idle_limit_s and silent_s <= limit_s:
            return ""
        what = "not ready after" if sets_up else "no beat for"
        return f"{words + ': ' if words else ''}{what} {silent_s:.1f} s, idle for {idle_s:.1f} s"

    def _take_look(self, t_ns: int) -> None:
        """Notes whether the process has worked since the last look."""
        cpu_ns, waits = self._look(self._pid)
        self._on_disk = self._on_disk or waits
        if self._cpu_ns >= 0 and cpu_ns - self._cpu_ns >= WORKS_SHARE * (t_ns - self._looked_ns):
            self._worked_ns = t_ns
        self._cpu_ns, self._looked_ns = cpu_ns, t_ns
