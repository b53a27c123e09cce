"""The processes of all stages: started when needed, checked, restarted, and ended in two passes."""

from collections.abc import Callable, Iterable, Iterator

import attrs

from lfpipe.config import SessionOptions
from lfpipe.host import signals
from lfpipe.supervisor.process_table import SOURCE, STAGES, Stage
from lfpipe.supervisor.stage_process import StageProcess
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.session import Session
from lfpipe.transport.stage_spec import StageSpec
from lfpipe.transport.status import ENDED, Table

DRAIN_NS = 2 * SECOND_NS  # time for the stages to finish their work after the source has ended


STOP_S, TERM_S, KILL_S = 0.9, 0.5, 5.0  # time limits after "stop", after SIGTERM, after SIGKILL
PASSES = ((STOP_S, signals.END), (TERM_S, signals.KILL), (KILL_S, None))


@attrs.frozen
class Ended:
    """A stage that ended unexpectedly."""

    process: StageProcess
    code: int


class StageProcesses:
    """table: the status table. spec: the data a stage receives at its start. ask_to_stop: sends the stop to a stage."""

    def __init__(
        self, session: Session, table: Table, spec: Callable[[Stage], StageSpec], ask_to_stop: Callable[[str], None]
    ) -> None:
        self._table, self._spec, self._ask_to_stop = table, spec, ask_to_stop
        self._all = {stage.name: StageProcess(stage, session, table.rows[stage.name]) for stage in STAGES}
        self._drain_since_ns = 0

    def __iter__(self) -> Iterator[StageProcess]:
        return iter(self._all.values())

    def ensure_running(self, options: SessionOptions) -> None:
        """Starts stages that are needed, and asks stages that are no longer needed to stop."""
        for process in self:
            needed = process.stage.needed(options)
            process.wanted = needed and not self._drain_since_ns
            if process.wanted and not process.alive and now_ns() >= process.next_start_ns:
                process.start(self._spec(process.stage))
            elif process.alive and not needed:
                self._ask_to_stop(process.stage.name)

    def judge(self, log: Callable[[str], None]) -> list[Ended]:
        """Kills hung stages, and returns stages that ended unexpectedly."""
        ended = []
        for process in self:
            name = process.stage.name
            if why := process.overdue():
                log(f"{name}: {why}, killed\n{process.kill_hung()}".rstrip())
            code = process.reap()
            if code is None or (code == 0 and (process.stage.optional or not process.wanted)):
                continue
            if code == 0 and name == SOURCE:
                self._drain_since_ns = now_ns()
                continue
            ended.append(Ended(process, code))
        return ended

    def finished(self, every: int) -> bool:
        """Whether the source has ended and every stage has processed its last frame. every: n, one frame in n is tracked."""
        if not self._drain_since_ns:
            return False
        last = int(self._table.rows[SOURCE]["source_seq"]) - every + 1
        rows = [process.row for process in self if process.alive]
        done = all(int(row["source_seq"]) >= last or row["state"] in ENDED for row in rows)
        return done or now_ns() - self._drain_since_ns > DRAIN_NS

    def idle(self, options: SessionOptions) -> bool:
        """Whether nothing runs and nothing is needed."""
        return not any(process.alive or process.stage.needed(options) for process in self)

    def ready(self, options: SessionOptions) -> bool:
        """Whether every stage that is needed has been ready."""
        return all(int(process.row["ready_ns"]) > 0 for process in self if process.stage.needed(options))

    def applied(self, rev: int, options: SessionOptions) -> bool:
        """Whether every needed stage has applied revision rev, and no other stage runs."""
        return all(int(p.row["config_rev"]) >= rev for p in self if p.alive or p.stage.needed(options))

    def outputs(self, options: SessionOptions) -> dict[str, int]:
        """The number of outputs so far of every stage that is needed."""
        return {process.stage.name: int(process.row["seq"]) for process in self if process.stage.needed(options)}

    def kill(self) -> None:
        """Ends all at once: the user asked twice."""
        for process in self:
            process.signal(signals.KILL)

    def stop(self, log: Callable[[str], None]) -> None:
        """Asks all stages to stop, then waits for all."""
        for process in self:
            process.wanted = False
            self._ask_to_stop(process.stage.name)
        wait_for_end(self._all.values(), log)

    def close(self) -> None:
        """Releases the status table."""
        self._all.clear()


@attrs.define
class _Ending:
    process: StageProcess
    due_ns: int
    passes: int = 0
    logged: bool = False


def wait_for_end(processes: Iterable[StageProcess], log: Callable[[str], None]) -> None:
    """Waits until all processes have ended; the caller has asked them to stop. A late one gets SIGTERM, then SIGKILL, unless it
    saves results and makes progress. log: reports to people what the session waits for.
    """
    begin_ns = now_ns()
    waiting = [_Ending(process, begin_ns + int(STOP_S * 1e9)) for process in processes if process.alive]
    while waiting:
        for each in list(waiting):
            process = each.process
            process.join(0.01)
            process.reap()
            if not process.alive:
                waiting.remove(each)
            elif now_ns() < each.due_ns:
                continue
            elif words := process.saves:
                each.due_ns = now_ns() + int(STOP_S * 1e9)
                if not each.logged:
                    log(f"{process.stage.name}: {words}; press Ctrl-C again to end it at once")
                each.logged = True
            elif (signum := PASSES[each.passes][1]) is None:
                waiting.remove(each)
            else:
                process.signal(signum)
                each.passes += 1
                each.due_ns = now_ns() + int(PASSES[each.passes][0] * 1e9)
