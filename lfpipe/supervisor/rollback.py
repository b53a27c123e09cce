"""Rollback: if a stage fails on a change of configuration or scene, the change is undone, and the
session continues.
"""

from collections.abc import Iterator, Mapping

from lfpipe.supervisor.child import EXIT_TERMINATED
from lfpipe.supervisor.effects import Answer, Change, Effect, Notify, Publish, Service
from lfpipe.supervisor.pending_answers import PendingAnswers
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.stage_process import StageProcesses
from lfpipe.transport.clock import SECOND_NS

# counted after all stages have applied a change; a stage that cannot use it fails sooner
TRIAL_NS = 2 * SECOND_NS


class ConfigRollback:
    """Checks whether the stages can use the newest change."""

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._outputs: dict[str, int] = {}

    def watch(
        self, state: SessionState, applied: bool, outputs: Mapping[str, int], t_ns: int
    ) -> bool:
        """Whether a change is confirmed: every stage has used it and produced outputs for TRIAL_NS.
        Call often.

        outputs: number of outputs of each stage so far.
        """
        if state.basis == state.known_good or not applied:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = t_ns
            self._outputs = dict(outputs)
        elif t_ns - self._since_ns >= TRIAL_NS and all(
            n > self._outputs.get(name, 0) for name, n in outputs.items()
        ):
            self._since_ns = None
            return True
        return False

    def to_blame(self, state: SessionState, code: int, applied: bool) -> bool:
        """Whether a stage that ended with code most likely failed because of the newest change.

        applied: the stage had acknowledged the change; after that, only its own error counts.
        """
        own_error = code > 0 and code != EXIT_TERMINATED
        if state.basis == state.known_good or (applied and not own_error):
            return False
        self._since_ns = None
        return True


class Rollback(Service):
    """Confirms or undoes the newest change."""

    def __init__(self, stages: StageProcesses, pending: PendingAnswers) -> None:
        self._stages = stages
        self._pending = pending
        self._config = ConfigRollback()

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        needed = self._stages.needed(state.options)
        outputs = {process.stage.name: int(process.row["seq"]) for process in needed}
        applied = self._stages.have_applied(state.rev, state.options)
        if self._config.watch(state, applied, outputs, t_ns):
            yield Change(SessionState.settled)

    def to_blame(self, state: SessionState, code: int, applied: bool) -> bool:
        """See `ConfigRollback.to_blame`."""
        return self._config.to_blame(state, code, applied)

    def undo(self, stage: str, why: str) -> Iterator[Effect]:
        """Undoes the newest change, on which a stage failed.

        This does not count as a failure of the stage: `ctl set` must not end a session.
        """
        yield Change(SessionState.rolled_back)
        for request, answer in self._pending.refuse_changes(why):
            yield Answer(request, answer)
        yield Publish("refused", {"stage": stage, "why": why})
        yield Notify(f"the last change is rolled back: {why}")
