"""Faulty parts of stages, and failures at the end of a session."""

from collections.abc import Iterator

from lfpipe.config.modes import Lossless
from lfpipe.notices import Fault, faults
from lfpipe.supervisor.effects import Effect, EndKind, Notify, Outcome, Service
from lfpipe.supervisor.process_table import TRACKED_BY
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.stage_process import StageProcesses
from lfpipe.transport.status import Table


class FaultWatch(Service):
    """Notifies of new faults, and remembers the last ones."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._faults: list[Fault] = []

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        known = {fault.text for fault in self._faults}
        broken = list(faults(self._table.rows, t_ns))
        self._faults = broken or self._faults
        yield from (Notify(fault.text) for fault in broken if fault.text not in known)

    def note_last(self, t_ns: int) -> None:
        """Records the faults at the end, before the stages stop."""
        self._faults = list(faults(self._table.rows, t_ns))

    def failures_at_end(
        self, stages: StageProcesses, state: SessionState, outcome: Outcome
    ) -> Iterator[Outcome]:
        """Failures that override the normal end of a session: an output that a stage of a lossless
        session could not write at its end, a part that never worked, an output that ended early.
        """
        for process in stages if isinstance(state.options.clock, Lossless) else ():
            if mistake := process.mistake():
                yield Outcome(
                    kind=EndKind.FAILURE,
                    reason=f"{process.stage.name} could not end",
                    failure=mistake.message,
                    remedy=mistake.remedy,
                    user_error=True,
                )
        rows = self._table.rows
        never = [fault.text for fault in self._faults if not fault.has_worked]
        if rows[TRACKED_BY]["restarts"] and not rows[TRACKED_BY]["seq"]:
            never.append(f"{TRACKED_BY} failed before its first eyes")
        if never:
            remedy = "choose another one with --set track.engine or track.filter"
            failure = f"{outcome.reason}, but {never[0]}: it never worked"
            yield _failed(outcome, failure, remedy)
        if lost := sum(int(row["lost_outputs"]) for row in rows.values()):
            files = "a file of the session is" if lost == 1 else f"{lost} files of the session are"
            remedy = "see the messages above; free disk space, or use files on another disk"
            yield _failed(outcome, f"{outcome.reason}, but {files} incomplete", remedy)


def _failed(outcome: Outcome, failure: str, remedy: str) -> Outcome:
    return Outcome(kind=outcome.kind, reason=outcome.reason, failure=failure, remedy=remedy)
