"""The governor under loads of any shape, and the cores of stages."""

from collections.abc import Callable
from functools import cache, partial

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Config, DrawingCosts, Render, SceneSummary, SessionOptions
from lfpipe.config.quality import METHODS
from lfpipe.supervisor import process_table
from lfpipe.supervisor.metrics import GAP_S, Governor, Load, QualityControl, Step
from lfpipe.supervisor.session_state import SessionState
from lfpipe.transport.ring import SECOND_NS
from lfpipe.transport.status import ROW, State
from tests.config.test_quality import ERRORS
from tests.supervisor.states import SCENE
from tests.support.examples import examples

DT_NS = SECOND_NS // 10
ALL = frozenset(("capture", "track", "render"))
EASY = {
    "capture": Load(3, 0, 3_000_000),
    "track": Load(3, 0, 6_000_000),
    "render": Load(6, 0, 12_000_000),
}
TIGHT = {**EASY, "render": Load(6, 0, 75_000_000)}  # neither lag nor room
LATE = {**EASY, "render": Load(3, 3, 60_000_000)}
FULL = {**EASY, "render": Load(6, 0, 97_000_000)}
LOST = {**EASY, "track": Load(2, 1, 60_000_000)}
Loads = dict[str, Load]
LAGS = (LATE, FULL, LOST)


class Run:
    """A governor fed every DT_NS; steps: (time in s, step)."""

    def __init__(self, levels: int = 5) -> None:
        self.governor = Governor([ALL] * levels)
        self.t_ns = 0
        self.steps: list[tuple[float, Step]] = []
        self.governor.update(0, EASY)

    def feed(self, loads: Loads, dt_ns: int = DT_NS) -> Step | None:
        self.t_ns += dt_ns
        step = self.governor.update(self.t_ns, loads)
        if step is not None:
            self.steps.append((self.t_ns / 1e9, step))
        return step

    def feed_for(self, loads: Loads, seconds: float) -> None:
        for _ in range(round(seconds * SECOND_NS / DT_NS)):
            self.feed(loads)

    @property
    def rises(self) -> list[float]:
        return [t_s for t_s, step in self.steps if not step.stage]


spells = st.lists(
    st.tuples(st.sampled_from((EASY, TIGHT, LATE, FULL, LOST)), st.floats(0.1, 15)), max_size=25
)


@examples(40)
@given(spells)
def test_governor_changes_the_level_after_lag_and_headroom_alone(
    load: list[tuple[Loads, float]],
) -> None:
    run = Run()
    before, lag_s, room_s = 0, 0.0, 0.0
    for loads, seconds in load:
        for _ in range(round(seconds * SECOND_NS / DT_NS)):
            lag_s += 0.1 * (loads in LAGS)
            room_s += 0.1 * (loads is EASY)
            step = run.feed(loads)
            assert run.governor.level == (before if step is None else step.level)
            if step is not None:
                assert lag_s > 0.5 - 1e-6 if step.level > before else room_s > 5 - 1e-6
                assert (step.stage in ALL) == (step.level > before)
                before = step.level
                lag_s = 0.0
                room_s = 0.0
            assert 0 <= run.governor.level <= 5


Spell = tuple[Loads, float, int]  # the load, for how many s, and the level then
QUIET = {**EASY, "render": Load(0, 0, 0)}
WAKING = {**EASY, "render": Load(6, 90, 5_000_000)}
SLOW = {**EASY, "render": Load(1, 59, SECOND_NS)}
DOWN = (LATE, 0.5, 1)
PLAYS: dict[str, list[Spell]] = {
    "late": [(LATE, 5.4, 5), (EASY, 25.6, 0)],
    "always busy": [(FULL, 5.4, 5), (EASY, 25.6, 0)],
    "loses frames": [(LOST, 5.4, 5), (EASY, 25.6, 0)],
    "a second without room cancels five with": [
        DOWN,
        (EASY, 4.0, 1),
        (TIGHT, 0.2, 1),
        (EASY, 1.8, 1),
        (EASY, 0.4, 0),
    ],
    "two fifths of one cancel two": [
        DOWN,
        (EASY, 4.0, 1),
        (TIGHT, 0.4, 1),
        (EASY, 2.8, 1),
        (EASY, 0.4, 0),
    ],
    "a second without lag cancels half of one": [
        (LATE, 0.4, 0),
        (TIGHT, 0.4, 0),
        (LATE, 0.2, 0),
        (LATE, 0.1, 1),
    ],
    "no output: room for a second, then unknown": [
        DOWN,
        (EASY, 3.0, 1),
        (QUIET, 5.0, 1),
        (EASY, 0.9, 1),
        (EASY, 0.2, 0),
    ],
    "lost soon: twice the wait": [
        DOWN,
        (EASY, 5.1, 0),
        (TIGHT, 9.0, 0),
        DOWN,
        (EASY, 9.8, 1),
        (EASY, 0.4, 0),
    ],
    "lost later: the same wait": [DOWN, (EASY, 5.1, 0), (TIGHT, 60.0, 0), DOWN, (EASY, 5.1, 0)],
    "a burst leads to the end of the last one, and back": [
        (LATE, 3.0, 3),
        (EASY, 5.1, 0),
        (EASY, 20.0, 0),
        (LATE, 0.6, 3),
        (EASY, 5.1, 0),
    ],
    "one level above a burst: that before, then one by one": [
        (LATE, 1.8, 2),
        (EASY, 5.1, 0),
        (LATE, 0.6, 1),
        (EASY, 10.1, 0),
    ],
    "a burst of a second costs one level": [(LATE, 1.0, 1), (EASY, 5.1, 0)],
    "hiccups": [(LATE, 0.1, 0), (EASY, 0.3, 0)] * 50 + [(LATE, 0.4, 0), (EASY, 1.2, 0)] * 50,
    "a process that was stopped and goes on": [(QUIET, 1.5, 0), (WAKING, 0.1, 0), (EASY, 2.0, 0)],
    "pictures that take a second each": [
        (QUIET, 0.9, 0),
        (SLOW, 0.1, 0),
        (QUIET, 0.9, 0),
        (SLOW, 0.1, 1),
    ],
}


@pytest.mark.parametrize("name", PLAYS)
def test_governor_level_after_each_spell_of_load(name: str) -> None:
    run = Run()
    for number, (loads, seconds, level) in enumerate(PLAYS[name]):
        run.feed_for(loads, seconds)
        assert run.governor.level == level, f"spell {number}"


@examples(20)
@given(st.floats(GAP_S + 0.01, 3600))
def test_governor_forgets_over_a_gap_in_time(gap_s: float) -> None:
    run = Run()
    run.feed_for(LATE, 0.6)
    run.feed_for(EASY, 4.8)
    run.feed(EASY, int(gap_s * 1e9))
    run.feed_for(EASY, 4.8)
    assert run.governor.level == 1
    run.feed(LATE, int(gap_s * 1e9))
    run.feed_for(LATE, 0.4)
    assert run.governor.level == 1


@cache
def simulated_hour(name: str) -> tuple[int, list[tuple[float, int]]]:
    """Number of changes, and (time in s, level) of each, where other programs take a share of the
    CPU.
    """
    governor = Governor([ALL] * 6)
    costs_ms = (14, 9, 6, 4, 3, 2, 1.5)  # of a picture at each level
    changes: list[tuple[float, int]] = []
    for number in range(36_000):
        t_s = number / 10
        since = next((t for t, level in reversed(changes) if level == 0), 0.0)
        share = FOREIGN[name](t_s, 0.0 if governor.level else t_s - since)
        cost_ms = costs_ms[governor.level] / (1 - share)
        done = min(6, int(100 / cost_ms))
        busy_ns = round(min(6 * cost_ms, 100) * 1e6)
        loads = {**EASY, "render": Load(done, 6 - done, busy_ns)}
        if governor.update(number * DT_NS, loads) is not None:
            changes.append((t_s, governor.level))
    return len(changes), changes


def bursts(burst_s: float, period_s: float, t_s: float, _: float) -> float:
    """Other programs that take four fifths of the CPU for burst_s in each period_s."""
    return 0.8 * (t_s % period_s < burst_s)


# share(time in s, for how long the level has been full in s)
FOREIGN: dict[str, Callable[[float, float], float]] = {
    "1 s in 12": lambda t_s, _: 0.8 * (t_s % 12 < 1),
    "13 s in 26": lambda t_s, _: 0.7 * (t_s % 26 < 13),
    "throttled after 12 s of full quality": lambda _, full_s: 0.6 * (full_s > 12),
    "throttled after 30 s of full quality": lambda _, full_s: 0.6 * (full_s > 30),
    "half of it, always": lambda *_: 0.5,
    **{
        f"{burst_s} s in {period_s}": partial(bursts, burst_s, period_s)
        for burst_s, period_s in ((12, 40), (12, 120), (30, 300))
    },
}


@pytest.mark.parametrize("name", FOREIGN)
def test_governor_changes_at_most_60_times_an_hour(name: str) -> None:
    count, _ = simulated_hour(name)
    assert 1 <= count <= 60


@pytest.mark.parametrize(("name", "most"), [("12 s in 120", 0.5), ("30 s in 300", 0.15)])
def test_governor_is_at_full_quality_between_rare_bursts(name: str, most: float) -> None:
    """One level at a time, it was lower for nine tenths of the time."""
    _, changes = simulated_hour(name)
    times, levels = zip(*changes, (3600.0, 0), strict=True)
    spans = np.diff(times)
    assert spans[np.array(levels[:-1]) > 0].sum() <= most * 3600


COSTS = DrawingCosts(ns_per_px={"warp": 7.0, "nearest": 1.5}, picture_px=512**2, cores=2)


def _rows() -> dict[str, np.ndarray]:
    table = np.zeros(3, ROW)
    table["state"] = State.RUNNING
    return {
        name: table[i : i + 1].reshape(()) for i, name in enumerate(("capture", "track", "render"))
    }


class Session:
    """A state whose level follows from the load, as in the supervisor's loop."""

    def __init__(
        self,
        config: Config | None = None,
        cores: dict[str, tuple[int, ...]] | None = None,
        scene: SceneSummary = SCENE,
    ) -> None:
        self.state = SessionState.first(
            config or Config(), SessionOptions(scene=scene, costs=COSTS)
        )
        self.rows = _rows()
        self.t_ns = 0
        self.control = QualityControl(cores or {})

    def work(self, seconds: float, of: str, lost: str) -> None:
        """Samples a session in which one count of one stage grows as fast as its outputs."""
        for _ in range(round(seconds * SECOND_NS / DT_NS)):
            self.t_ns += DT_NS
            for row in self.rows.values():
                row["seq"] += 3
                row["busy_ns"] += 3_000_000
            if of:
                self.rows[of][lost] += 3
            step = self.control.sample(self.state, self.rows, self.t_ns)
            if step is not None:
                self.state = self.state.with_level(step.level)


@pytest.mark.parametrize(
    ("clock", "stage", "lost", "lags"),
    [
        ("display", "render", "missed", True),
        # a refresh takes the newest eyes, and leaves those before
        ("display", "render", "drops", False),
        ("camera", "render", "drops", True),
        ("display", "track", "drops", True),
        ("display", "capture", "drops", True),
        ("display", "track", "left_out", False),
    ],
)
def test_quality_control_detects_visible_lag(clock: str, stage: str, lost: str, lags: bool) -> None:
    session = Session(Config(render=Render(clock=clock)))  # type: ignore[arg-type]
    session.work(1.0, stage, lost)
    assert (session.state.level.number >= 1) == lags


def test_quality_control_judges_nothing_while_a_stage_starts() -> None:
    session = Session()
    session.rows["track"]["state"] = State.STARTING
    session.work(5.0, "render", "missed")
    session.rows["track"]["state"] = State.RUNNING
    session.work(0.9, "render", "missed")
    assert session.state.level.number == 0


drawing_costs = st.builds(
    DrawingCosts,
    ns_per_px=st.sampled_from(
        [
            dict(zip(METHODS, ns, strict=True))
            for ns in ((10, 7, 2, 1.5), (30, 9, 8, 7), (9, 8, 7, 1))
        ]
    ),
    picture_px=st.integers(10_000, 8_000_000),
    cores=st.integers(1, 4),
)


@given(drawing_costs, drawing_costs, st.integers(0, 9))
def test_costs_that_are_measured_again_leave_the_level_in_use(
    first: DrawingCosts, again: DrawingCosts, number: int
) -> None:
    session = Session(scene=attrs.evolve(SCENE, errors=ERRORS))
    before = session.state.with_costs(first)
    session.state = before = before.with_level(min(number, len(before.levels) - 1))
    session.work(0.3, "", "")
    session.state = before.with_costs(again)
    start, lowest = session.state.level.number, session.state.levels[-1].number
    assert start >= min(before.level.number, lowest), "it is measured on a busy machine, too"
    session.work(1.0, "render", "missed")
    assert session.state.level.number == min(start + 1, lowest), "it goes down from there"
    session.work(60.0, "", "")
    assert session.state.level.number == session.state.best_level, "and up to what fits, no higher"


def test_quality_control_takes_no_level_that_does_not_help() -> None:
    eye_distance: dict[str, tuple[int, ...]] = {"capture": (0,), "track": (1,), "render": (0,)}
    session = Session(Config(render=Render(clock="camera")), eye_distance)
    session.work(5.0, "track", "drops")
    assert len(session.state.levels) > 1 and session.state.level.number == 0, (
        "cheaper views give no time to a core of its own"
    )
    session.t_ns = 100 * SECOND_NS
    session.work(1.0, "capture", "drops")
    assert session.state.level.number >= 1, "but to capture, on the same core"
    session = Session(
        cores=eye_distance
    )  # the last level helps: the others are taken on the way to it
    session.work(5.0, "track", "drops")
    assert session.state.level == session.state.levels[-1] and session.state.level.every == 2


@pytest.mark.parametrize(
    ("load", "lags", "room"),  # of render in 0.1 s
    [
        (Load(9, 1, 50_000_000), False, False),  # a tenth missed
        (Load(8, 1, 50_000_000), True, False),
        (Load(6, 0, 90_000_000), False, False),  # nine tenths of the time
        (Load(6, 0, 90_001_000), True, False),
        (Load(6, 0, 59_999_000), False, True),
        (Load(6, 0, 60_000_000), False, False),
    ],
)
def test_governor_bounds_of_lag_and_headroom(load: Load, lags: bool, room: bool) -> None:
    full, lowered = Run(), Run(levels=1)
    full.feed_for({**EASY, "render": load}, 0.6)
    lowered.feed_for(LATE, 0.6)
    lowered.feed_for({**EASY, "render": load}, 5.2)
    assert (full.governor.level, lowered.governor.level) == (int(lags), int(not room))


def test_cores_give_tracking_one_of_two() -> None:
    own = {"capture": (4,), "track": (6,), "render": (4,)}
    assert (
        process_table.cores([4, 6]).items() >= own.items()
        and process_table.cores([0]) == process_table.cores(range(8)) == {}
    )
