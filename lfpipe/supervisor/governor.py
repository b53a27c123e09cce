"""Decides when to lower and raise the quality, from the load of the stages alone. Uses no process,
clock or file.

A stage lags if it misses more than a tenth of the due outputs, or is nearly always busy. It has
headroom if it misses none and is rarely busy. Half a second of lag lowers the quality by one level;
five seconds of headroom restore the level before. The next burst of lag then leads to the level
where the last one ended, so that each costs two changes. A level that is lost within ten seconds
doubles the headroom time required, up to five minutes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import QualityLevel
from lfpipe.supervisor.process_table import CORE, DOES, SHOWN_BY
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.ring import SECOND_NS
from lfpipe.transport.status import State

# Viewers notice lag immediately; frequent changes of level are more annoying than a lower one. A
# second without lag, or without headroom, cancels as much of it.
LAG_S, HEADROOM_S = 0.5, 5.0
MAX_HEADROOM_S = 300.0  # maximum headroom time before a higher level is tried
KEPT_S = 10.0  # a level that lags sooner was tried in vain
# There is a store of changes, so that a load that comes and goes changes the picture some 50 times
# an hour. A raise waits for two: it may be lost.
CHANGES, CHANGE_EVERY_S = 10.0, 75.0
PAUSE_S = 0.7  # after a loss: a burst of a second costs one level
# of the outputs due; one or two frames in half a second are due to the scheduler
LATE_SHARE = 0.1
FULL_SHARE, HEADROOM_SHARE = 0.9, 0.6  # busy share of the time: above is lag, below is headroom
HICCUP_S = 0.25  # limit of one sample: a process that was stopped or starved once does not lag
# Between two samples, or checks of the stages: the machine or the supervisor was suspended or
# starved, probably like the stages. After this time without output,
# the headroom of a stage is unknown.
GAP_S = 1.0
SAMPLE_NS = SECOND_NS // 10  # five samples within LAG_S
SETTLE_NS = SECOND_NS  # after a start: caches are cold, and the first pictures are late

Rows = Mapping[str, NDArray[np.void]]


@attrs.frozen
class Load:
    """A stage's work within a span of time."""

    done: int = 0
    """Completed outputs."""
    missed: int = 0
    """Due outputs that were never made."""
    busy_ns: int = 0
    """Busy time."""
    span_s: float = 0.0

    def plus(self, more: Load) -> Load:
        """The work of both spans."""
        return Load(
            self.done + more.done,
            self.missed + more.missed,
            self.busy_ns + more.busy_ns,
            self.span_s + more.span_s,
        )

    @property
    def share(self) -> float:
        """Busy share of the time."""
        return self.busy_ns / 1e9 / max(self.span_s, 1e-9)


@attrs.frozen
class Step:
    """A change of level."""

    level: int
    """The new level."""
    stage: str = ""
    """The lagging stage; "" when the level is raised."""
    load: Load = Load()
    """The work of the stage while it lagged."""

    @property
    def reason(self) -> str:
        """The reason for the change, for people."""
        load = self.load
        if not self.stage:
            return "CPU is free again"
        if load.missed:
            return (
                f"{self.stage} missed {load.missed} of {load.done + load.missed} in"
                f" {load.span_s:.1f} s"
            )
        return f"{self.stage} is busy {100 * load.share:.0f} % of its time"


@attrs.define
class _Stage:
    """The governor's data of a stage."""

    silent: Load = Load()
    """Its work since it last made or missed an output."""
    lag_s: float = 0.0
    """Duration of its lag."""
    lagging: Load = Load()
    """Its work during the lag."""

    def take(self, sample: Load) -> bool | None:
        """Adds a sample; returns whether there was headroom, None if unknown."""
        load = self.silent.plus(sample)
        due = load.done + load.missed
        self.silent = Load() if due else load
        if not due:
            return None if load.span_s > GAP_S else True
        lags = load.missed > LATE_SHARE * due or load.share > FULL_SHARE
        change_s = min(load.span_s, HICCUP_S) if lags else -LAG_S * load.span_s
        self.lag_s = max(0.0, self.lag_s + change_s)
        self.lagging = self.lagging.plus(load) if self.lag_s else Load()
        return load.missed == 0 and load.share < HEADROOM_SHARE


class Governor:
    """The level of a session. relieves: for each level from 1 on, the stages that it relieves."""

    def __init__(self, relieves: Sequence[frozenset[str]]) -> None:
        self.level = 0
        self._relieves = tuple(relieves)
        self._required_s = HEADROOM_S  # headroom time required to raise the level
        self._changes = CHANGES
        self._raised_ns = self._lost_ns = -math.inf
        self._in_burst = False  # whether a level was lost since the last raise
        self._before = self._deepest = 0  # the levels before the last burst and at its end
        self._t_ns = -math.inf
        self._headroom_s = 0.0
        self._stages: dict[str, _Stage] = {}

    def _forget(self) -> None:
        """Discards the past, which does not describe the current load."""
        self._headroom_s = 0.0
        self._stages.clear()

    def update(self, t_ns: int, loads: Mapping[str, Load]) -> Step | None:
        """Adds the work of every stage since the last sample; returns the resulting step, if any.

        Starts over after a gap: a stage has started, the machine was suspended, ...
        """
        dt_s = (t_ns - self._t_ns) / 1e9
        self._t_ns = t_ns
        if dt_s > GAP_S:
            self._forget()
            return None
        headrooms = [
            self._stages.setdefault(name, _Stage()).take(attrs.evolve(load, span_s=dt_s))
            for name, load in loads.items()
        ]
        if False in headrooms:
            self._headroom_s = max(0.0, self._headroom_s - HEADROOM_S * dt_s)
        elif headrooms and None not in headrooms:
            self._headroom_s += dt_s
        relieved = self._relieves[self.level] if self.level < len(self._relieves) else ()
        lags = {name: stage for name, stage in self._stages.items() if name in relieved}
        worst = max(lags, key=lambda name: lags[name].lag_s, default="")
        self._changes = min(self._changes + dt_s / CHANGE_EVERY_S, CHANGES)
        if t_ns - self._lost_ns < PAUSE_S * 1e9:
            self._stages.clear()
            return None
        if worst and lags[worst].lag_s >= LAG_S:
            self._lost_ns = t_ns
            step = Step(self._lowered(t_ns), worst, lags[worst].lagging)
        elif self.level and self._headroom_s >= self._required_s and self._changes >= 2:
            self._raised_ns = t_ns
            self._in_burst = False
            step = Step(min(self._before, self.level - 1))
        else:
            return None
        self.level = step.level
        self._changes -= 1
        self._forget()
        return step

    def _lowered(self, t_ns: int) -> int:
        """The next level, now that this one lags."""
        lower = self.level + 1
        if not self._in_burst and t_ns - self._raised_ns < KEPT_S * 1e9:
            self._required_s = min(2 * self._required_s, MAX_HEADROOM_S)
        elif not self._in_burst:
            self._required_s = HEADROOM_S
            self._before = self.level
            lower = max(lower, self._deepest)
        self._in_burst = True
        self._deepest = lower
        return lower


class QualityControl:
    """Decides the level. cores: stage -> cores that it may run on; without an entry, all."""

    def __init__(self, cores: Mapping[str, tuple[int, ...]]) -> None:
        self._cores = cores
        self._levels: tuple[QualityLevel, ...] = ()
        self._before: dict[str, tuple[int, int, int]] = {}
        self._due_ns = self._settled_ns = 0

    def sample(self, state: SessionState, rows: Rows, t_ns: int) -> Step | None:
        """Reads the table, at most every SAMPLE_NS; returns the resulting change of level,
        if any.
        """
        if state.levels != self._levels:  # begins at full quality
            self._levels = state.levels
            # the stages that run faster at a level share cores with the relieved one
            helped = [
                {
                    name
                    for name in CORE
                    if self._cores.get(name) == self._cores.get(DOES[level.work])
                }
                for level in self._levels[1:]
            ]
            # Levels are lowered in order: a stage that only a later
            # level relieves needs the earlier ones too.
            self._governor = Governor(
                [frozenset[str]().union(*helped[number:]) for number in range(len(helped))]
            )
        if len(self._levels) == 1 or t_ns < self._due_ns:
            return None
        self._due_ns = t_ns + SAMPLE_NS
        used = {
            name: rows[name]
            for name in CORE
            if rows[name]["state"] not in (State.NONE, State.FINISHED)
        }
        if any(row["state"] != State.RUNNING for row in used.values()):
            self._settled_ns = t_ns + SETTLE_NS
        if t_ns < self._settled_ns:  # for the governor, a gap
            self._before.clear()
            return None
        # on a display's clock, only refreshes count as missed,
        # not the eyes skipped between two refreshes
        on_camera = state.config.render.clock == "camera" and state.options.viewer.tracked
        late = {SHOWN_BY: "drops" if on_camera else "missed"}
        counts = {
            name: (int(row["seq"]), int(row[late.get(name, "drops")]), int(row["busy_ns"]))
            for name, row in used.items()
        }
        before = self._before
        self._before = counts
        loads = {
            name: Load(*np.subtract(now, before.get(name, now)).tolist())
            for name, now in counts.items()
        }
        return self._governor.update(t_ns, loads)
