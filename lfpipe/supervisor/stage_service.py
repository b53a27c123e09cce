"""The stages of a session: starts, and failures that cause a rollback, a restart or the end."""

from collections import deque
from collections.abc import Iterator, Sequence

from lfpipe.config.modes import Lossless
from lfpipe.supervisor import child
from lfpipe.supervisor.effects import Effect, EndKind, Notify, Outcome, Publish, Service
from lfpipe.supervisor.rollback import Rollback
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.stage_process import (
    MAX_FAILURES,
    MAX_RESTARTS_WINDOW_S,
    StageProcess,
    StageProcesses,
)

RECORDER_ENDED = "the recorder stopped early and nothing else was running"


class StageFailures(Service):
    """Handles failed stages by a rollback, a restart, or the end of the session."""

    def __init__(self, stages: StageProcesses, rollback: Rollback) -> None:
        self._stages = stages
        self._rollback = rollback
        self._ended: deque[tuple[StageProcess, int]] = deque()

    @property
    def fds(self) -> Sequence[int]:
        return self._stages.ended_fds

    def wait_ns(self, t_ns: int) -> int | None:
        return 0 if self._ended else None

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        self._ended.extend(self._stages.check())
        if self._ended:  # one at a time: the next one may fail on another state
            yield from self._failed(state, *self._ended.popleft())

    def _failed(self, state: SessionState, process: StageProcess, code: int) -> Iterator[Effect]:
        name = process.stage.name
        row = process.row
        mistake = process.mistake() if code == child.EXIT_USER else None
        if self._rollback.to_blame(state, code, int(row["config_rev"]) >= state.rev):
            why = f"{mistake.message} ({mistake.remedy})" if mistake else f"{name} fails with it"
            yield from self._rollback.undo(name, why)
            return
        first = not row["seq"]  # it has never worked
        # later in a live session, the missing thing may return
        if mistake and (first or isinstance(state.options.clock, Lossless)):
            yield Outcome(
                kind=EndKind.FAILURE,
                reason=f"{name} could not {'start' if first else 'continue'}",
                failure=mistake.message,
                remedy=mistake.remedy,
                user_error=True,
            )
            return
        phase = "RUNNING" if row["ready_ns"] else "STARTING"
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        why = f": {mistake.message}" if mistake else ""
        last = int(row["source_seq"])
        yield Publish("failed", {"stage": name, "code": code, "phase": phase, "source_seq": last})
        if not process.failed():
            yield Notify(f"{name} ended with {how} in {phase}{why}; restarting")
            return
        stack = process.last_stack()
        many = f"{name} failed {MAX_FAILURES} times in {MAX_RESTARTS_WINDOW_S:.0f} s"
        left = f"its last stack:\n{stack}" if stack else "it left no stack"
        yield Outcome(
            kind=EndKind.FAILURE,
            reason=many,
            failure=f"{many}, last in {phase} with {how}{why}, after source_seq {last}; {left}",
            remedy="see the messages above; `lfpipe doctor` checks the machine",
        )


class StageStarts(Service):
    """Starts the stages that the session needs, and ends a session that needs none any more."""

    def __init__(self, stages: StageProcesses) -> None:
        self._stages = stages

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        self._stages.ensure_running(state.options)
        if self._stages.finished(state.level.every):
            yield Outcome(kind=EndKind.SOURCE_ENDED, reason="the source has ended")
        if not self._stages.needed(state.options, or_alive=True):
            yield Outcome(
                kind=EndKind.FAILURE,
                reason=RECORDER_ENDED,
                failure=RECORDER_ENDED,
                remedy="see the messages above",
            )
