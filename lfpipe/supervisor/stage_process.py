"""The processes of the stages: start, heartbeat check, restart, and shutdown in two passes."""

import logging
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.config.session_options import Lossless
from lfpipe.errors import UserError
from lfpipe.host import signals
from lfpipe.host.files import exists
from lfpipe.host.worker import PATIENCE, Child, is_stopped, python
from lfpipe.supervisor import child
from lfpipe.supervisor.control_sockets import EXECUTE_NS
from lfpipe.supervisor.metrics import GAP_S
from lfpipe.supervisor.process_table import SOURCE, STAGES, Stage
from lfpipe.transport.context import StageSpec
from lfpipe.transport.control import Session
from lfpipe.transport.ring import now_ns
from lfpipe.transport.status import ENDED, State, Table, busy_work, clear

logger = logging.getLogger(__name__)
MAX_RESTARTS_WINDOW_S, MAX_FAILURES = 60.0, 5  # give up after five failures in a minute
FIRST_BACKOFF_S = 0.1  # doubled from one failure to the next
MAX_STACK = 4000  # characters reported
# without a heartbeat: twice the longest time of a stage beside 12 busy loops for each core, 2.7 s
HANG_S = 5.5
# likewise: time for a disk to spin up, for a network to return, or for a display server that other
# programs overload
BUSY_S = 60.0
# time limits after "stop", after SIGTERM (on a busy machine), after SIGKILL
STOP_S, TERM_S, KILL_S = 0.9, 3.0, 5.0
PASSES = ((STOP_S, signals.END), (TERM_S, signals.KILL), (KILL_S, None))


class StageProcess:
    """Starts, checks and ends one stage. row: its record of the status table, writable."""

    def __init__(self, stage: Stage, session: Session, row: NDArray[np.void]) -> None:
        self.stage = stage
        self.row = row
        self._session = session
        self.process: Child | None = None
        self.must_run = False  # the session needs it now, so its end is a failure
        self.next_start_ns = 0
        self.failures: deque[int] = deque(maxlen=MAX_FAILURES)
        self.lossless = False
        self.source = ""  # of the viewer that it was started for
        self.is_leaving = False  # it was asked to stop: its end is no failure, even if needed again
        self._killed = False  # killed for a hang, but not ended yet
        self._checked_ns = self._awake_ns = 0

    @property
    def alive(self) -> bool:
        return self.process is not None

    def fits(self, options: SessionOptions) -> bool:
        """Whether it may go on with these options: it is needed, and for the same viewer."""
        is_same = self.source == options.viewer.source or not self.stage.restart_on_viewer_change
        may_go_on = not self.alive or (is_same and not self.is_leaving)
        return may_go_on and self.stage.needed(options)

    def start(self, spec: StageSpec) -> None:
        """Spawns the process.

        Only from the main thread: PR_SET_PDEATHSIG is tied to the starting thread.
        """
        for what in ("error", "stack"):
            child.crash_report_path(self._session.run_dir, what, self.stage.name).unlink(
                missing_ok=True
            )
        if self.row["pid"] and self.row["state"] != State.FINISHED:
            self.row["restarts"] += 1
        self._checked_ns = self._awake_ns = now_ns()
        clear(self.row, "ready_ns", "busy_with", "busy_since_ns", "cpu_ns", "fault")
        self.row["state"] = State.STARTING
        self.row["started_ns"] = self._checked_ns
        self._killed = self.is_leaving = False
        self.source = spec.options.viewer.source
        self.lossless = isinstance(spec.options.clock, Lossless)
        with signals.blocked():
            self.process = Child(python("lfpipe.supervisor.child"), child.start_line(spec))
        self.row["pid"] = self.process.pid
        logger.info(
            "%s starts as process %d, restart %d",
            self.stage.name,
            self.process.pid,
            self.row["restarts"],
        )

    def reap(self) -> int | None:
        """Exit code when the process has ended since the last call, else None."""
        if self.process is None or (code := self.process.poll()) is None:
            return None
        self.process.close()
        self.process = None
        finished = code in (0, child.EXIT_TERMINATED)
        if self.must_run:  # otherwise, the end may be intended
            finished = code == 0 and (self.stage.name == SOURCE or self.stage.optional)
        clear(self.row, "busy_with", "busy_since_ns")
        self.row["state"] = State.FINISHED if finished else State.DEAD
        self.row["dead_ns"] = now_ns()
        logger.info(
            "%s ended with code %d after %.1f s",
            self.stage.name,
            code,
            (now_ns() - int(self.row["started_ns"])) / 1e9,
        )
        if code == 0:
            self.row["taken_seq"] = 0  # its work was done, so its successor has missed nothing
        return code

    def hang_reason(self) -> str:
        """The reason why the process counts as hung, or "": no heartbeat for HANG_S; for BUSY_S
        while it starts, within `Context.busy_with` and the like, and in a lossless replay, whose
        time is not critical, unless a signal has stopped it. Otherwise stopping: `wait_for_end`
        decides. Call often.
        """
        if self.process is None or self._killed:
            return ""
        row = self.row
        t_ns = now_ns()
        if t_ns - self._checked_ns > GAP_S * 1e9:
            self._awake_ns = t_ns  # the machine was suspended, or starved all processes alike
        self._checked_ns = t_ns
        work = busy_work(row)
        sets_up = row["state"] == State.STARTING or not row["ready_ns"]
        if row["state"] == State.STOPPING and not work:
            return ""
        silent_s = (t_ns - max(int(row["beat_ns"]), int(row["started_ns"]), self._awake_ns)) / 1e9
        if silent_s <= HANG_S * PATIENCE:
            return ""
        may_wait = work or sets_up or self.lossless
        if may_wait and silent_s <= BUSY_S * PATIENCE and not is_stopped(int(row["pid"])):
            return ""
        return (
            f"{work + ': ' if work else ''}{'not ready after' if sets_up else 'no beat for'}"
            f" {silent_s:.1f} s"
        )

    @property
    def saving_description(self) -> str:
        """A description of the results that the process writes at its end, while it makes progress;
        else "".
        """
        return (
            busy_work(self.row)
            if self.row["state"] == State.STOPPING and not self.hang_reason()
            else ""
        )

    def kill(self) -> None:
        """Kills a hung process. On a stalled machine its end may take long."""
        self.signal(signals.KILL)
        self._killed = True

    def last_stack(self) -> str:
        """The stack that the process wrote on request or on failure; empty if it was killed."""
        return self._report("stack")[-MAX_STACK:].rstrip()

    def failed(self) -> bool:
        """Restart policy: counts a failure and sets the time of the next start; True after too many
        failures.
        """
        t_ns = now_ns()
        self.failures.append(t_ns)
        recent = [f for f in self.failures if t_ns - f < MAX_RESTARTS_WINDOW_S * 1e9]
        self.next_start_ns = t_ns + int(FIRST_BACKOFF_S * 2 ** (len(recent) - 1) * 1e9)
        return len(recent) >= MAX_FAILURES

    def mistake(self) -> UserError | None:
        """The user error that ended the stage, if any."""
        return UserError.from_json(self._report("error").encode())

    def _report(self, what: str) -> str:
        path = child.crash_report_path(self._session.run_dir, what, self.stage.name)
        return path.read_text(errors="replace") if exists(path) else ""

    def signal(self, signum: int) -> None:
        """Sends one of `host.signals` if there is a process."""
        if self.process is not None:
            self.process.send_signal(signum)


class StageProcesses:
    """All stages of a session.

    table: the status table. spec: returns the specification of a stage. ask_to_stop: sends the stop
    to a stage. notify: notifies the user.
    """

    def __init__(
        self,
        session: Session,
        table: Table,
        spec: Callable[[Stage], StageSpec],
        ask_to_stop: Callable[[str], None],
        notify: Callable[[str], None],
    ) -> None:
        self._table = table
        self._notify = notify
        self._spec = spec
        self._ask_to_stop = ask_to_stop
        self._all = {
            stage.name: StageProcess(stage, session, table.rows[stage.name]) for stage in STAGES
        }
        self._drain_since_ns = 0

    def __iter__(self) -> Iterator[StageProcess]:
        return iter(self._all.values())

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the supervisor when a stage ends."""
        return [one.process.ended_fd for one in self if one.process is not None]

    def ensure_running(self, options: SessionOptions) -> None:
        """Starts the stages that are needed, and stops those that do not fit."""
        for process in self:
            fits = process.fits(options)
            process.must_run = fits and not self._drain_since_ns
            if process.must_run and not process.alive and now_ns() >= process.next_start_ns:
                self._start(process)
            elif process.alive and not fits:
                process.is_leaving = True
                self._ask_to_stop(process.stage.name)

    def _start(self, process: StageProcess) -> None:
        """Starts a stage, or later if the system has no process or memory to spare now. Raises
        UserError after too many attempts.
        """
        try:
            process.start(self._spec(process.stage))
        except OSError as error:
            process.row["state"] = State.DEAD
            why = f"{process.stage.name} cannot be started: {error.strerror}"
            if process.failed():
                raise UserError(
                    why, "end other programs, or raise the limits of processes and memory"
                ) from error
            self._notify(f"{why}; trying again")

    def check(self) -> list[tuple[StageProcess, int]]:
        """Kills hung stages, and returns stages that ended unexpectedly, with their exit codes."""
        failures = []
        for process in self:
            name = process.stage.name
            if why := process.hang_reason():
                process.signal(signals.LEAVE_STACK)
                time.sleep(0.05)
                self._notify(f"{name}: {why}, killed\n{process.last_stack()}".rstrip())
                process.kill()
            code = process.reap()
            if code is not None and process.row["state"] == State.DEAD:
                failures.append((process, code))
            elif code is not None and process.must_run and name == SOURCE:
                self._drain_since_ns = now_ns()
        return failures

    def finished(self, every: int) -> bool:
        """Whether the source has ended and every stage has processed its last frame.

        every: n, one frame in n is tracked.
        """
        if not self._drain_since_ns:
            return False
        last = int(self._table.rows[SOURCE]["source_seq"]) - every + 1
        rows = [process.row for process in self if process.alive]
        done = all(int(row["source_seq"]) >= last or row["state"] in ENDED for row in rows)
        return done or now_ns() - self._drain_since_ns > EXECUTE_NS

    def needed(self, options: SessionOptions, or_alive: bool = False) -> list[StageProcess]:
        """The stages that a session with these options needs, running or not.

        or_alive: include those that still run.
        """
        return [
            process
            for process in self
            if process.stage.needed(options) or (or_alive and process.alive)
        ]

    def have_applied(self, rev: int, options: SessionOptions) -> bool:
        """Whether every stage has applied revision rev of the state, and stages that are no longer
        needed have ended.
        """
        return all(
            int(process.row["config_rev"]) >= rev for process in self.needed(options, or_alive=True)
        )

    def stop(self) -> None:
        """Asks all stages to stop, then waits for all."""
        for process in self:
            process.must_run = False
            self._ask_to_stop(process.stage.name)
        wait_for_end(self._all.values(), self._notify)

    def close(self) -> None:
        """Stops the stages, unless they have ended, and releases the status table."""
        self.stop()
        self._all.clear()


def wait_for_end(stages: Collection[StageProcess], notify: Callable[[str], None]) -> None:
    """Waits until all processes have ended; the caller has asked them to stop. Late ones get
    SIGTERM, then SIGKILL, unless one saves results and makes progress. notify: notifies the user of
    the reason for the wait.
    """
    reported: set[str] = set()
    for limit_s, signum in PASSES:
        due_ns = now_ns() + int(limit_s * 1e9)
        while alive := [process for process in stages if process.alive]:
            if now_ns() >= due_ns:
                texts = {process.stage.name: process.saving_description for process in alive}
                saving = {name: text for name, text in texts.items() if text}
                if not saving:
                    break
                for name in saving.keys() - reported:
                    notify(f"{name}: {saving[name]}; press Ctrl-C again to end it at once")
                reported |= saving.keys()
                due_ns = now_ns() + int(limit_s * 1e9)
            time.sleep(0.005)
            for process in alive:
                process.reap()
        for process in alive:
            if signum is not None:
                process.signal(signum)
