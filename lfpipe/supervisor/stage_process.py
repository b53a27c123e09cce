"""A row of the process table at run time: its process, failures and restart policy."""

import logging
import multiprocessing
import os
import time
from collections import deque
from multiprocessing.process import BaseProcess

import numpy as np
from numpy.typing import NDArray

from lfpipe.host import processes, signals
from lfpipe.host.files import exists
from lfpipe.supervisor import child
from lfpipe.supervisor.health_check import HealthCheck
from lfpipe.supervisor.process_table import Stage
from lfpipe.transport.clock import now_ns
from lfpipe.transport.session import Session
from lfpipe.transport.stage_spec import StageSpec
from lfpipe.transport.status import State, busy_words

logger = logging.getLogger(__name__)
MAX_RESTARTS_WINDOW_S, MAX_FAILURES = 60.0, 5
FIRST_BACKOFF_S, MAX_BACKOFF_S = 0.1, 5.0
MAX_STACK = 4000  # characters reported


class StageProcess:
    """Starts, checks and ends one stage. row: its record of the status table, writable."""

    def __init__(self, stage: Stage, session: Session, row: NDArray[np.void]) -> None:
        self.stage, self.row, self._session = stage, row, session
        self.process: BaseProcess | None = None
        self.next_start_ns = 0
        self.failures: deque[int] = deque(maxlen=MAX_FAILURES)
        self.wanted = False
        self._killed = False  # killed for a hang, but not ended yet
        self._health: HealthCheck | None = None

    @property
    def alive(self) -> bool:
        return self.process is not None

    def start(self, spec: StageSpec) -> None:
        """Spawns the process. Only from the main thread: PR_SET_PDEATHSIG is tied to the starting thread."""
        for path in (child.error_file, child.stack_file):
            path(self._session.run_dir, self.stage.name).unlink(missing_ok=True)
        if self.row["pid"] and self.row["state"] != State.FINISHED:
            self.row["restarts"] += 1
        self.row["state"], self.row["ready_ns"], self.row["started_ns"] = State.STARTING, 0, now_ns()
        self.row["busy_with"], self.row["busy_since_ns"] = b"", 0
        self._killed = False
        self.process = multiprocessing.get_context("spawn").Process(
            target=child.run,
            args=(spec, os.getpid(), processes.HandedOver() if self.stage.source else None),
            name=f"lfpipe-{self.stage.name}",
            daemon=True,
        )
        with signals.blocked():
            self.process.start()
        if self.stage.source:
            processes.close_handed_over()  # the child has them: the camera must close with it
        self.row["pid"] = self.process.pid
        logger.info("%s starts as process %d, restart %d", self.stage.name, self.process.pid, self.row["restarts"])
        self._health = HealthCheck(self.stage, self.row, int(self.row["pid"]))

    def reap(self) -> int | None:
        """Exit code when the process has ended since the last call, else None."""
        if self.process is None or self.process.exitcode is None:
            return None
        code = self.process.exitcode
        self.process.join()
        self.process.close()
        self.process = None
        in_order = (0,) if self.wanted else (0, child.EXIT_TERMINATED)
        finished = code in in_order and (not self.wanted or self.stage.source or self.stage.optional)  # no work is left
        self.row["state"], self.row["dead_ns"] = State.FINISHED if finished else State.DEAD, now_ns()
        self.row["busy_with"], self.row["busy_since_ns"] = b"", 0
        logger.info("%s ended with code %d after %.1f s", self.stage.name, code, (now_ns() - int(self.row["started_ns"])) / 1e9)
        if code == 0:
            self.row["taken_seq"] = 0  # its work was done, so its successor has missed nothing
        return int(code)

    def overdue(self) -> str:
        """Why the process counts as hung, or ""; see `health_check`. Call often."""
        return "" if self.process is None or self._health is None or self._killed else self._health.problem()

    @property
    def saves(self) -> str:
        """The results that the process is writing at its end, in words, while it makes progress; else ""."""
        if self.row["state"] != State.STOPPING or self.overdue():
            return ""
        return busy_words(self.row)

    def join(self, timeout_s: float) -> None:
        """Waits for the process to end."""
        if self.process is not None:
            self.process.join(timeout_s)

    def kill_hung(self) -> str:
        """Kills a hung process, once, and returns its stack. On a stalled machine its end may take long."""
        if self.process is not None and self.process.pid is not None:
            signals.ask_for_stack(self.process.pid)
        time.sleep(0.05)
        stack = self.last_stack()
        self.signal(signals.KILL)
        self._killed = True
        return stack

    def last_stack(self) -> str:
        """The stack that the process left, on request or when it failed; empty if it was killed."""
        path = child.stack_file(self._session.run_dir, self.stage.name)
        return path.read_text(errors="replace")[-MAX_STACK:].rstrip() if exists(path) else ""

    def failed(self) -> bool:
        """Restart policy: counts a failure and sets the time of the next start; True after too many failures."""
        t_ns = now_ns()
        self.failures.append(t_ns)
        recent = [f for f in self.failures if t_ns - f < MAX_RESTARTS_WINDOW_S * 1e9]
        backoff_s = min(FIRST_BACKOFF_S * 2 ** (len(recent) - 1), MAX_BACKOFF_S)
        self.next_start_ns = t_ns + int(backoff_s * 1e9)
        return len(recent) >= MAX_FAILURES

    def died_of(self) -> tuple[str, str] | None:
        """(message, remedy) if the stage ended because of a user's mistake."""
        path = child.error_file(self._session.run_dir, self.stage.name)
        if not exists(path):
            return None
        message, _, remedy = path.read_text().partition("\n")
        return message, remedy

    def signal(self, signum: int) -> None:
        """Sends END or KILL of `host.signals` if there is a process to take it."""
        if self.process is not None and self.process.pid is not None:
            os.kill(self.process.pid, signum)
