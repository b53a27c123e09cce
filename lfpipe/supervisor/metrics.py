"""What the status table alone says: the state of a session, the common source of `lfpipe monitor`,
its page, `ctl status`, `--json`, and the end of `lfpipe up`; and when to lower and raise the
quality, by the load of the stages, without any process, clock or file.

A stage lags if it misses more than a tenth of the due outputs, or is nearly always busy. It has
headroom if it misses none and is rarely busy. Half a second of lag lowers the quality by one level;
five seconds of headroom restore the level before. The next burst of lag then leads to the level
where the last one ended, so that each costs two changes. A level that is lost within ten seconds
doubles the headroom time required, up to five minutes.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import QualityLevel
from lfpipe.host.worker import usable_cores
from lfpipe.notices import notices
from lfpipe.supervisor.process_table import CORE, DOES, SHOWN_BY, SOURCE, TRACKED_BY
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.ring import SECOND_NS, now_ns
from lfpipe.transport.status import MetricSet, State, Times, busy_work, rate_hz, summary_ms

SEATED = "seated"  # the viewer of a session without pictures, while tracking sees a face


@attrs.frozen(kw_only=True)
class StageMetrics:
    """One stage."""

    state: str
    """A name of `State`."""
    busy_with: str
    """The work that blocks it, with its duration; "" if none."""
    fps: float
    """Outputs per second."""
    p50_ms: float
    """Of its busy time."""
    p95_ms: float
    p99_ms: float
    max_ms: float
    wait: Times
    """From publication by the previous stage until taken by this one."""
    busy: Times
    """From taken to published."""
    dropped: int
    """Inputs that it lost."""
    count: int
    """Outputs."""
    pid: int
    left_out: int
    """Inputs skipped on purpose."""
    missed: int
    """Refreshes of the display without a picture from it."""
    restarts: int
    cpu_s: float
    face: bool
    """Whether its newest input showed a face."""
    cpus: list[int]
    """The cores that it may use now."""
    metrics: dict[str, Any]
    """The metrics that it declares, by name: of type `transport.metrics.Value`."""
    cpu_percent: float | None = None
    """Known to monitors that follow a session."""
    rss_mb: float | None = None

    @classmethod
    def of(cls, row: NDArray[np.void], declared: MetricSet) -> "StageMetrics":
        """The metrics in a row of the table."""
        busy = summary_ms(row["busy"])
        metrics = declared.read(row)
        work = busy_work(row)
        since_s = (now_ns() - int(row["busy_since_ns"])) / 1e9
        pid = int(row["pid"])
        return cls(
            state=State(int(row["state"])).name,
            busy_with=f"{work}, {since_s:.0f} s" if work and since_s > 0.5 else "",
            fps=round(rate_hz(row), 2),
            p50_ms=busy["p50_ms"],
            p95_ms=busy["p95_ms"],
            p99_ms=busy["p99_ms"],
            max_ms=busy["max_ms"],
            wait=summary_ms(row["wait"]),
            busy=busy,
            dropped=int(row["drops"]),
            count=int(row["seq"]),
            pid=pid,
            left_out=int(row["left_out"]),
            missed=int(row["missed"]),
            restarts=int(row["restarts"]),
            cpu_s=round(int(row["cpu_ns"]) / 1e9, 2),
            face=bool(metrics.get("face")),
            cpus=usable_cores(pid) if pid else [],
            metrics=metrics,
        )


@attrs.frozen(kw_only=True)
class Judder:
    """Refreshes of a screen that reports its vertical blanks."""

    planned: int
    juddered: int
    """Those that showed another picture than planned."""
    percent: float | None
    """None if no screen reports its vertical blanks."""


@attrs.frozen(kw_only=True)
class MotionToPhoton:
    """Latency of the picture behind the viewer, see docs/photon.md; None without head motion."""

    onset_ms: float | None
    steady_ms: float | None


@attrs.frozen(kw_only=True)
class SessionMetrics:
    """A session, as `lfpipe monitor --once --json` prints it."""

    session: str
    uptime_s: float
    camera_fps: float
    level: int
    """Of quality; 0 is full."""
    lowest_level: int
    level_words: str
    """The reductions; during a change, possibly those of another level."""
    viewer: str
    """The viewer's presence."""
    notices: list[str]
    """For people."""
    stages: dict[str, StageMetrics]
    end_to_end: Times
    """Age of a picture, from the sensor's stamp to its presentation."""
    judder: Judder
    prediction: Times
    """How far ahead of the sensor's stamp the eyes are predicted."""
    motion_to_photon: MotionToPhoton

    @property
    def used_stages(self) -> dict[str, StageMetrics]:
        """The stages that the session has needed."""
        return {name: stage for name, stage in self.stages.items() if stage.state != "NONE"}

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for JSON and messages."""
        return attrs.asdict(
            self, filter=lambda field, value: field.name not in EXTRA or value is not None
        )


EXTRA = ("cpu_percent", "rss_mb")  # present only if known


def session_metrics(
    session: str,
    rows: Mapping[str, NDArray[np.void]],
    declared: Mapping[str, MetricSet],
    quality: NDArray[np.void],
    started_ns: int,
) -> SessionMetrics:
    """The metrics of a session. rows, declared: of the stages, as a `status.Table` has them.
    quality: dtype SESSION.
    """
    stages = {
        name: StageMetrics.of(row, declared[name])
        for name, row in rows.items()
        if name in CORE or row["state"] != State.NONE
    }
    display: dict[str, Any] = stages[SHOWN_BY].metrics
    # without pictures, no stage follows the viewer
    follows = stages[SHOWN_BY].state != State.NONE.name or not stages[TRACKED_BY].face
    level = int(quality["level"])
    description = quality["words"].item().decode(errors="replace")
    planned, juddered = display["planned"], display["juddered"]
    t_face_ns, source = display["t_face_ns"], stages[SOURCE].metrics
    now = [notice.text for notice in notices(rows, SOURCE, SHOWN_BY, t_face_ns, source)]
    return SessionMetrics(
        session=session,
        uptime_s=round((now_ns() - started_ns) / 1e9, 2),
        camera_fps=stages[SOURCE].fps,
        level=level,
        lowest_level=int(quality["lowest"]),
        level_words=description,
        viewer=display["viewer"] if follows else SEATED,
        notices=[*now, f"quality lowered: {description}"] if level else now,
        stages=stages,
        end_to_end=summary_ms(rows[SHOWN_BY]["age"]),
        judder=Judder(
            planned=planned,
            juddered=juddered,
            percent=round(100 * juddered / planned, 3) if planned else None,
        ),
        prediction=display["prediction"],
        motion_to_photon=MotionToPhoton(
            onset_ms=display["onset_ms"], steady_ms=display["steady_ms"]
        ),
    )


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

    def plus(self, other: "Load") -> "Load":
        """The work of both spans."""
        return Load(
            self.done + other.done,
            self.missed + other.missed,
            self.busy_ns + other.busy_ns,
            self.span_s + other.span_s,
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

    def add(self, sample: Load) -> bool | None:
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

    def __init__(self, relieves: Sequence[frozenset[str]], level: int = 0) -> None:
        self.level = level
        self.best = 0
        """No better level is tried."""
        self._relieves = tuple(relieves)
        self._required_s = HEADROOM_S  # headroom time required to raise the level
        self._changes = CHANGES
        self._raised_ns = self._lost_ns = -math.inf
        self._before, self._deepest = 0, level  # before the last burst and at its end
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
            self._stages.setdefault(name, _Stage()).add(attrs.evolve(load, span_s=dt_s))
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
            step = Step(self._lowered(t_ns), worst, lags[worst].lagging)
            self._lost_ns = t_ns
        elif self.level > self.best and self._headroom_s >= self._required_s and self._changes >= 2:
            self._raised_ns = t_ns
            step = Step(max(self.best, min(self._before, self.level - 1)))
        else:
            return None
        self.level = step.level
        self._changes -= 1
        self._forget()
        return step

    def _lowered(self, t_ns: int) -> int:
        """The next level, now that this one lags."""
        lower = self.level + 1
        in_burst = self._lost_ns > self._raised_ns
        if not in_burst and t_ns - self._raised_ns < KEPT_S * 1e9:
            self._required_s = min(2 * self._required_s, MAX_HEADROOM_S)
        elif not in_burst:
            self._required_s = HEADROOM_S
            self._before = self.level
            lower = max(lower, self._deepest)
        self._deepest = lower
        return lower


class QualityControl:
    """Decides the level. cores: stage -> cores that it may run on; without an entry, all."""

    def __init__(self, cores: Mapping[str, tuple[int, ...]]) -> None:
        self._cores = cores
        self._levels: tuple[QualityLevel, ...] = ()
        self._governor = Governor(())
        self._before: dict[str, tuple[int, int, int]] = {}
        self._due_ns = self._settled_ns = 0

    def sample(self, state: SessionState, rows: Rows, t_ns: int) -> Step | None:
        """Reads the table, at most every SAMPLE_NS; returns the resulting change of level,
        if any.
        """
        if state.levels != self._levels or state.level.number != self._governor.level:
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
                [frozenset[str]().union(*helped[number:]) for number in range(len(helped))],
                state.level.number,
            )
        if len(self._levels) == 1 or t_ns < self._due_ns:
            return None
        self._due_ns = t_ns + SAMPLE_NS
        self._governor.best = state.best_level
        active = {
            name: rows[name]
            for name in CORE
            if rows[name]["state"] not in (State.NONE, State.FINISHED)
        }
        if any(row["state"] != State.RUNNING for row in active.values()):
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
            for name, row in active.items()
        }
        before = self._before
        self._before = counts
        loads = {
            name: Load(*np.subtract(now, before.get(name, now)).tolist())
            for name, now in counts.items()
        }
        return self._governor.update(t_ns, loads)
