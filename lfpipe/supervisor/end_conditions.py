"""Ends a session on a signal, after its duration, or when its files are removed."""

from collections.abc import Iterator, Sequence

from lfpipe.host.file_lock import Lock
from lfpipe.supervisor.effects import Effect, EndKind, Outcome, Service
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.supervisor.stage_process import StageProcesses
from lfpipe.transport.clock import SECOND_NS


class FilesInPlace(Service):
    """Ends a session whose lock or shared memory was removed: without the lock, it no longer
    receives commands, and the next session of that name cannot detect it.
    """

    def __init__(self, lock: Lock, run_dir: str, store: SessionStore) -> None:
        self._lock = lock
        self._run_dir = run_dir
        self._store = store

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        if not self._lock.in_place():
            yield Outcome(
                kind=EndKind.FAILURE,
                reason="its run directory was removed",
                failure=f"{self._run_dir} was removed while the session ran",
                remedy="set XDG_RUNTIME_DIR to a directory that no program cleans",
            )
        if removed := self._store.removed():
            yield Outcome(
                kind=EndKind.FAILURE,
                reason="its shared memory was removed",
                failure=f"{removed} was removed while the session ran",
                remedy="find the program that cleans that folder, and exclude lfp-*",
            )


class Limits(Service):
    """Ends a session on a signal, or after its duration, which starts when all stages are ready.
    signals: received signals.
    """

    def __init__(
        self, stages: StageProcesses, duration_s: float | None, signals: Sequence[int]
    ) -> None:
        self._stages = stages
        self._duration_s = duration_s
        self._signals = signals
        self._end_ns: int | None = None

    def wait_ns(self, t_ns: int) -> int | None:
        return None if self._end_ns is None else self._end_ns - t_ns

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        if self._signals:
            yield Outcome(kind=EndKind.SIGNAL, reason="interrupted", signum=self._signals[0])
        if self._duration_s is None:
            return
        if self._end_ns is None and self._stages.are_ready(state.options):
            self._end_ns = t_ns + int(self._duration_s * SECOND_NS)
        if self._end_ns is not None and t_ns >= self._end_ns:
            yield Outcome(kind=EndKind.DURATION, reason="finished (--duration reached)")
