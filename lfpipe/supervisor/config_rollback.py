"""Rollback: if a stage fails on a change of configuration or scene, the change is undone, and the session continues."""

from collections.abc import Mapping

from lfpipe.supervisor.child import EXIT_TERMINATED
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.clock import SECOND_NS

TRIAL_NS = 2 * SECOND_NS  # counted after all stages have applied a change; a stage that cannot use it fails sooner


class ConfigRollback:
    """Watches whether the stages can use the newest change."""

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._outputs: dict[str, int] = {}

    def watch(self, state: SessionState, applied: bool, outputs: Mapping[str, int], t_ns: int) -> SessionState:
        """Call often. A change is settled, and the state marked so, when every stage has used it and produced outputs for
        TRIAL_NS.

        outputs: number of outputs of each stage so far.
        """
        if state.basis == state.known_good or not applied:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns, self._outputs = t_ns, dict(outputs)
        elif t_ns - self._since_ns >= TRIAL_NS and all(n > self._outputs.get(name, 0) for name, n in outputs.items()):
            self._since_ns = None
            return state.settled()
        return state

    def to_blame(self, state: SessionState, code: int, applied: bool) -> bool:
        """Whether a stage that ended with code most likely failed because of the newest change.

        applied: the stage had acknowledged the change; after that, only its own error counts.
        """
        own_error = code > 0 and code != EXIT_TERMINATED
        if state.basis == state.known_good or (applied and not own_error):
            return False
        self._since_ns = None
        return True
