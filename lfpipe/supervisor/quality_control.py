"""The quality of a running session: reads the load of its stages from the status table and decides the level."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import QualityLevel
from lfpipe.supervisor.governor import Governor, Load, Step
from lfpipe.supervisor.process_table import CORE, DOES, SHOWN_BY
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.status import State

SAMPLE_NS = SECOND_NS // 10
SETTLE_NS = SECOND_NS  # after a start: caches are cold, and the first pictures are late

Rows = Mapping[str, NDArray[np.void]]


def reason(step: Step) -> str:
    """Why the level changed, for people."""
    if not step.stage:
        return "CPU is free again"
    load = step.load
    due, share = load.done + load.missed, load.busy_ns / 1e9 / max(step.span_s, 1e-9)
    if load.missed:
        return f"{step.stage} missed {load.missed} of {due} in {step.span_s:.1f} s"
    return f"{step.stage} is busy {100 * share:.0f} % of its time"


class QualityControl:
    """Decides the level. cores: stage -> cores it may run on, empty for all."""

    def __init__(self, cores: Callable[[str], tuple[int, ...]]) -> None:
        self._cores = cores
        self._levels: tuple[QualityLevel, ...] = ()
        self._before: dict[str, tuple[int, int, int]] = {}
        self._due_ns = self._settled_ns = 0

    def sample(self, state: SessionState, rows: Rows, t_ns: int) -> Step | None:
        """Reads the table, at most every SAMPLE_NS; returns the resulting change of level, if any."""
        if state.levels != self._levels:
            self._begin(state.levels)
        if len(self._levels) == 1 or t_ns < self._due_ns:
            return None
        self._due_ns = t_ns + SAMPLE_NS
        used = {name: rows[name] for name in CORE if rows[name]["state"] not in (State.NONE, State.FINISHED)}
        if any(row["state"] != State.RUNNING for row in used.values()):
            self._settled_ns = t_ns + SETTLE_NS
        if t_ns < self._settled_ns:
            self._governor.forget()
            self._before.clear()
            return None
        on_camera = state.config.render.clock == "camera" and state.options.tracking
        counts = {name: _counts(row, name == SHOWN_BY and not on_camera) for name, row in used.items()}
        before, self._before = self._before, counts
        loads = {name: Load(*np.subtract(now, before.get(name, now)).tolist()) for name, now in self._before.items()}
        return self._governor.update(t_ns, loads)

    def _begin(self, levels: tuple[QualityLevel, ...]) -> None:
        """Replaces the levels, and starts at full quality."""
        self._levels = levels
        helped = [self._relieved(DOES[level.work]) for level in levels[1:]]
        # Levels are lowered in order: a stage that only a later level relieves needs the earlier ones too.
        self._governor = Governor([frozenset[str]().union(*helped[number:]) for number in range(len(helped))])

    def _relieved(self, stage: str) -> frozenset[str]:
        """The stages that run faster if `stage` has less work: those that may share a core with it."""
        cores = {name: set(self._cores(name)) for name in CORE}
        alone = [name for name, of in cores.items() if of and cores[stage] and not of & cores[stage]]
        return frozenset(CORE).difference(alone)


def _counts(row: NDArray[np.void], on_display: bool) -> tuple[int, int, int]:
    """Completed outputs, missed outputs, ns of work, so far. For a display's clock, only refreshes count as missed, not the eyes
    skipped between two refreshes."""
    return int(row["seq"]), int(row["missed" if on_display else "drops"]), int(row["busy_ns"])
