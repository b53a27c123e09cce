"""The quality of a running session: what the stages do, read from the status table, and the level that follows from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config
from lfpipe.quality import Level, ladder
from lfpipe.supervisor.governor import Governor, Load, Step
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.status import State

STAGES = ("capture", "track", "render")  # those that a picture waits for
SAMPLE_NS = SECOND_NS // 10
SETTLE_NS = SECOND_NS  # after a start: caches are cold, and the first pictures are late

Rows = Mapping[str, NDArray[np.void]]


def why(step: Step) -> str:
    """What a stage did while it lagged, for a person; that there is room, on the way up."""
    if not step.stage:
        return "there is room again"
    load = step.load
    due, share = load.done + load.missed, load.busy_ns / 1e9 / max(step.span_s, 1e-9)
    if load.missed:
        return f"{step.stage} missed {load.missed} of {due} in {step.span_s:.1f} s"
    return f"{step.stage} needs {100 * share:.0f} % of its time"


class Levels:
    """The ladder that config and options allow, and where on it the session stands.

    steady: nothing may depend on load (lossless running). cores: stage -> cores it may run on, empty for all.
    """

    def __init__(self, config: Config, options: Mapping[str, Any], steady: bool, cores: Callable[[str], tuple[int, ...]]) -> None:
        self._steady, self._cores = steady, cores
        self._ladder: tuple[Level, ...] = ()
        self._before: dict[str, tuple[int, int, int]] = {}
        self._due_ns = self._settled_ns = 0
        self.follow(config, options)

    @property
    def now(self) -> Level:
        """The level in force."""
        return self._ladder[self._governor.level]

    @property
    def lowest(self) -> int:
        """Number of the last level."""
        return len(self._ladder) - 1

    def follow(self, config: Config, options: Mapping[str, Any]) -> None:
        """Takes another configuration or scene; where that changes the ladder, it begins at full quality."""
        whole = ladder(config, options)
        steps = whole[:1] if self._steady or config.governor.quality == "fixed" else whole
        if steps != self._ladder:
            self._ladder = steps
            helped = [self._relieved(level.stage) for level in steps[1:]]
            # Who is helped by a later level only is worth the way there: levels are taken in order.
            self._governor = Governor([frozenset[str]().union(*helped[number:]) for number in range(len(helped))])
        self._on_camera = config.render.clock == "camera" and bool(options["tracking"])

    def _relieved(self, stage: str) -> frozenset[str]:
        """Stages that run faster when `stage` has less to do: those that it may have to share a core with."""
        cores = {name: set(self._cores(name)) for name in STAGES}
        alone = [name for name, of in cores.items() if of and cores[stage] and not of & cores[stage]]
        return frozenset(STAGES).difference(alone)

    def sample(self, rows: Rows, t_ns: int) -> Step | None:
        """Looks at the table, at most every SAMPLE_NS; the step that follows, if one does."""
        if not self.lowest or t_ns < self._due_ns:
            return None
        self._due_ns = t_ns + SAMPLE_NS
        used = {name: rows[name] for name in STAGES if rows[name]["state"] not in (State.NONE, State.FINISHED)}
        if any(row["state"] != State.RUNNING for row in used.values()):
            self._settled_ns = t_ns + SETTLE_NS
        if t_ns < self._settled_ns:
            self._governor.forget()
            self._before.clear()
            return None
        before, self._before = self._before, {name: self._counts(name, row) for name, row in used.items()}
        loads = {name: Load(*np.subtract(now, before.get(name, now)).tolist()) for name, now in self._before.items()}
        return self._governor.update(t_ns, loads)

    def _counts(self, name: str, row: NDArray[np.void]) -> tuple[int, int, int]:
        """Outputs made, outputs missed, ns of work, so far. A display's clock misses refreshes; what render leaves of the eyes
        that come between two of them is no loss."""
        missed = "missed" if name == "render" and not self._on_camera else "drops"
        return int(row["seq"]), int(row[missed]), int(row["busy_ns"])
