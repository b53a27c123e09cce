"""Decides when a stage counts as hung. The rule for each phase tolerates slow machines and slow disks.

Time in which the process was ready to run but had no CPU never counts (`time_spent`). A gap of ASLEEP_S between two checks
does not count either: the machine was suspended, or starved all processes alike.

Setting up (from the start to READY, and within `Context.setting_up`): hung after startup_timeout_s without computing or moving
a byte, or after LONGEST_S of computing without a byte. Running or stopping within `Context.busy_with` and `saving`, around
calls that may wait for a disk: hung after startup_timeout_s of computing without a byte, or after STALL_S of doing nothing.
Running otherwise: hung after hang_timeout_s without a beat, or COMPUTING times as long while it computes: on an emulated
machine one search for a face takes seconds. Undeclared waiting for a disk (a page of a mapped file) does not count. Stopping
otherwise: see the limits of `shutdown`.

In every phase, a stage that waits for a disk is hung if no byte arrives for STALL_S. A stopped stage (SIGSTOP) is hung
after startup_timeout_s while it sets up, and after hang_timeout_s while it runs.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lfpipe.host import activity
from lfpipe.host.sample import Sample
from lfpipe.supervisor.process_table import Stage
from lfpipe.supervisor.time_spent import TimeSpent
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.status import State, busy_words

ASLEEP_S = 1.0  # after such a gap between checks, the supervisor was stopped or starved, probably like the stages
STALL_S = 60.0  # time for a disk to spin up, or for a network to return
LONGEST_S = 600.0  # of continuous computing: imports and tables of a large scene on an emulated machine
COMPUTING = 5  # hang timeouts of computing without a beat
SAMPLE_AFTER_NS, SAMPLE_NS = 500 * MS_NS, 50 * MS_NS  # /proc is read only for a stage that has been silent for a while


class HealthCheck:
    """The health of one process. row: its record of the status table. sample: reads /proc."""

    def __init__(
        self, stage: Stage, row: NDArray[np.void], pid: int, sample: Callable[[int], Sample | None] = activity.sample
    ) -> None:
        self._stage, self._row, self._pid, self._sample = stage, row, pid, sample
        self._checked_ns = self._excused_ns = now_ns()
        self._sign = (0, 0, 0, 0)
        self._spent = TimeSpent()
        self._last: tuple[int, Sample] | None = None

    def problem(self) -> str:
        """Why the process counts as hung, or "". Call often."""
        t_ns = now_ns()
        if t_ns - self._checked_ns > ASLEEP_S * 1e9:
            self._excused_ns, self._sign = t_ns, (0, 0, 0, 0)
        self._checked_ns = t_ns
        row = self._row
        state, ready_ns = int(row["state"]), int(row["ready_ns"])
        words = busy_words(row)
        if state == State.STOPPING and not words:
            return ""
        sign = (state, int(row["beat_ns"]), ready_ns, int(row["busy_since_ns"]))
        if sign != self._sign:
            self._sign, self._last = sign, None
        silent_ns = t_ns - max(int(row["beat_ns"]), int(row["started_ns"]), self._excused_ns)
        if silent_ns < SAMPLE_AFTER_NS or not self._take_sample(t_ns, silent_ns):
            return ""
        return self._diagnose(state == State.STARTING or not ready_ns, words, silent_ns / 1e9)

    def _take_sample(self, t_ns: int, silent_ns: int) -> bool:
        """Samples the process if it is time to; returns whether it exists."""
        if self._last is not None and t_ns - self._last[0] < SAMPLE_NS:
            return True
        now = self._sample(self._pid)
        if now is None:
            return False
        if self._last is None:
            self._spent = TimeSpent(able=silent_ns)
        else:
            self._spent.add(self._last[1], now, t_ns - self._last[0])
        self._last = t_ns, now
        return True

    def _diagnose(self, sets_up: bool, words: str, silent_s: float) -> str:
        spent, stage = self._spent, self._stage
        at = f"{words}: " if words else ""
        if spent.stalled > STALL_S * 1e9:
            return f"{at}no data from its disk for {spent.stalled / 1e9:.0f} s"
        if sets_up and (spent.idle > stage.startup_timeout_s * 1e9 or spent.unmoved > LONGEST_S * 1e9):
            return f"{at}not ready after {silent_s:.0f} s, {spent.idle / 1e9:.0f} s of them idle"
        if sets_up:
            return ""
        if words and spent.waited > STALL_S * 1e9:
            return f"{at}no byte for {spent.waited / 1e9:.0f} s"
        if words and spent.worked <= stage.startup_timeout_s * 1e9 and spent.stopped <= stage.hang_timeout_s * 1e9:
            return ""
        still_s = (spent.able - (0 if words else spent.worked)) / 1e9
        hung = still_s > stage.hang_timeout_s or spent.worked / 1e9 > COMPUTING * stage.hang_timeout_s
        return f"{at}no beat for {silent_s:.1f} s" if hung else ""
