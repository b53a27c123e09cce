"""A session's steps, one after the other, on a clock and with stages that do what a test says: no
process runs.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import attrs
import numpy as np
import pytest
import zmq

from lfpipe.config import Render
from lfpipe.config.session_options import Lossless, MouseViewer
from lfpipe.errors import UserError
from lfpipe.host import signals
from lfpipe.notices import FAULT_NS
from lfpipe.supervisor import requests, session, stage_process
from lfpipe.supervisor.child import EXIT_USER, crash_report_path
from lfpipe.supervisor.control_sockets import EXECUTE_NS
from lfpipe.supervisor.session import IDLE_NS, INTERNAL, LiveSession, Outcome
from lfpipe.supervisor.stage_process import MAX_FAILURES
from lfpipe.transport import control
from lfpipe.transport.control import Session
from lfpipe.transport.ring import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.status import Histogram, State
from tests.supervisor.states import VIEWER, made_state
from tests.support.world import connected, until

STAGES = ("capture", "track", "render")


class Process:
    """A child without a process; it ends when a test sets its exit code, or by SIGKILL."""

    def __init__(self, *_: object) -> None:
        self.pid = os.getpid()
        self.exit_code: int | None = None
        self.ended_fd, self._held = os.pipe()

    def poll(self) -> int | None:
        return self.exit_code

    def send_signal(self, signum: int) -> None:
        if signum == signals.KILL:
            self.exit_code = -9

    def close(self) -> None:
        os.close(self.ended_fd)
        os.close(self._held)


class Played:
    """A session whose stages work from step to step. said: the notices to the user."""

    def __init__(self, name: str, monkeypatch: pytest.MonkeyPatch, **options: Any) -> None:
        self.t_ns = 10**12
        self.said: list[str] = []
        for module in (session, stage_process):
            monkeypatch.setattr(module, "now_ns", lambda: self.t_ns)
        monkeypatch.setattr(stage_process, "Child", Process)
        monkeypatch.setattr("lfpipe.supervisor.child.start_line", lambda spec: b"")
        self.dir = Session(name).run_dir
        self.dir.mkdir(mode=0o700)
        self.live = LiveSession(Session(name), made_state(**options), self.said.append)
        self.rows = self.live._table.rows
        self.resting: set[str] = set()  # stages that run and make nothing
        self.step(0.2)

    def goes_on(self) -> bool:
        return self.live._outcome is None

    def outcome(self) -> Outcome:
        assert self.live._outcome is not None
        return self.live._outcome

    def until(self, condition: Callable[[], bool]) -> None:
        """Goes on while no time passes."""

        def stepped() -> bool:
            self.live.step()
            return condition()

        until(stepped, "what a message causes")

    def step(self, seconds: float = 0.1) -> None:
        """Time passes in tenths of a second, in which the stages work."""
        for _ in range(round(seconds * 10)):
            self.t_ns += 100 * MS_NS
            for process in self.live.stages:
                if not process.alive or process.process.poll() is not None:  # type: ignore[union-attr]
                    continue
                row = process.row
                row["state"] = State.RUNNING
                row["ready_ns"] = row["ready_ns"] or self.t_ns
                row["beat_ns"] = self.t_ns
                row["config_rev"] = self.live.state.rev
                row["seq"] += process.stage.name not in self.resting
            self.live.step()

    def ends(self, code: int, *names: str, applied: bool = True) -> None:
        """These stages end, before the next step."""
        for process in self.live.stages:
            if process.stage.name in names:
                assert process.process is not None
                process.process.exit_code = code  # type: ignore[attr-defined]
                process.row["config_rev"] -= not applied

    def told(self, words: str) -> int:
        return sum(words in text for text in self.said)

    def restarts(self) -> list[int]:
        return [int(self.rows[name]["restarts"]) for name in STAGES]

    def change(self, **render: Any) -> None:
        state = self.live.state
        self.live._apply(state.changed(attrs.evolve(state.config, render=Render(**render))))


Play = Callable[..., Played]


@pytest.fixture
def play(base: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Play]:
    made: list[Played] = []

    def begin(**options: Any) -> Played:
        made.append(Played(name, monkeypatch, **options))
        return made[-1]

    yield begin
    for one in made:
        one.ends(0, *(each.stage.name for each in one.live.stages if each.alive))
        one.rows = {}
        with closing(one.live):
            pass


def test_of_two_stages_that_fail_at_once_one_undoes_the_change(play: Play) -> None:
    """The other one failed on a state that is gone: it starts again."""
    played = play()
    good = played.live.state.config
    played.change(alpha_px=9.0)
    played.ends(1, "track", "render")
    played.live.step()
    assert played.told("rolled back: track fails with it") == 1 and not played.told("restarting")
    assert played.live.state.config == good
    played.live.step()
    assert played.told("rolled back") == 1
    assert played.told("render ended with exit code 1") == played.told("restarting") == 1
    played.step(1)
    assert played.restarts() == [0, 1, 1]


@pytest.mark.parametrize(
    ("resting", "code", "undone"),
    [("", 1, False), ("", -9, False), ("track", 1, True), ("track", -9, False)],
)
def test_a_change_is_undone_until_every_stage_has_worked_with_it(
    play: Play, resting: str, code: int, undone: bool
) -> None:
    """A kill says nothing against a change that was applied."""
    played = play()
    played.resting.add(resting)
    played.change(alpha_px=9.0)
    played.step(2 * FAULT_NS / SECOND_NS)
    played.ends(code, "render")
    played.live.step()
    assert bool(played.told("rolled back")) is undone
    assert (played.live.state.config.render.alpha_px == 9.0) is not undone


def test_a_change_that_kills_a_stage_before_it_was_applied_is_undone(play: Play) -> None:
    played = play()
    played.change(alpha_px=9.0)
    played.ends(-11, "render", applied=False)
    played.live.step()
    assert played.told("rolled back") == 1 and not played.told("restarting")


def test_a_stage_that_fails_again_and_again_ends_the_session(play: Play) -> None:
    played = play()
    for number in range(MAX_FAILURES):
        assert played.goes_on()
        crash_report_path(played.dir, "stack", "render").write_text("at line 9\n")
        played.ends(-11, "render")
        played.step(2 + number)
    assert "in RUNNING with signal 11" in str(played.outcome().failure)
    assert str(played.outcome().failure).endswith("its last stack:\nat line 9")
    assert played.told("restarting") == MAX_FAILURES - 1 and played.restarts()[0] == 0


@pytest.mark.parametrize(
    ("worked", "clock", "ends"),
    [(False, {}, True), (True, {}, False), (True, {"clock": Lossless()}, True)],
)
def test_a_mistake_of_the_user_ends_a_session_that_never_worked_or_is_a_replay(
    play: Play, worked: bool, clock: dict[str, Any], ends: bool
) -> None:
    played = play(**clock)
    played.rows["capture"]["seq"] = worked
    report = crash_report_path(played.dir, "error", "capture")
    report.write_bytes(UserError("camera:0: unplugged", "plug it in").to_json())
    played.ends(EXIT_USER, "capture")
    played.live.step()
    if ends:
        assert played.outcome().user_error
        assert (played.outcome().failure, played.outcome().remedy) == (
            "camera:0: unplugged",
            "plug it in",
        )
    else:
        assert played.goes_on() and played.told("unplugged; restarting") == 1


def test_a_hung_stage_is_killed_named_and_started_again(play: Play) -> None:
    played = play()
    for _ in range(70):
        played.t_ns += 100 * MS_NS
        played.rows["capture"]["beat_ns"] = played.rows["track"]["beat_ns"] = played.t_ns
        played.live.step()
    played.step(1)
    assert played.told("render: no beat for") == 1 and played.restarts() == [0, 0, 1]


def test_a_stage_that_ends_by_itself_is_missed(play: Play) -> None:
    played = play()
    played.ends(0, "track")
    played.step(1)
    assert played.told("track ended with exit code 0") == 1 and played.restarts() == [0, 1, 0]


@pytest.mark.parametrize(("shown", "soon"), [(40, True), (38, False)])
def test_a_source_that_ends_ends_the_session_once_its_frames_are_shown(
    play: Play, shown: int, soon: bool
) -> None:
    played = play()
    played.rows["capture"]["source_seq"] = 40
    played.rows["track"]["source_seq"] = played.rows["render"]["source_seq"] = shown
    played.ends(0, "capture")
    played.step()
    assert played.goes_on() is not soon
    played.step(EXECUTE_NS / SECOND_NS + 0.2)
    assert played.outcome().source_ended
    assert played.restarts() == [0, 0, 0] and not played.said


def test_a_stage_that_is_no_longer_needed_is_asked_to_stop(play: Play) -> None:
    played = play(viewer=MouseViewer())
    alive = {each.stage.name for each in played.live.stages if each.alive}
    assert alive == {"render"}
    played.live._apply(played.live.state.changed(viewer=VIEWER))
    played.step()
    assert {each.stage.name for each in played.live.stages if each.alive} == set(STAGES)
    played.live._apply(played.live.state.changed(viewer=MouseViewer()))
    played.step()
    leaving = {each.stage.name for each in played.live.stages if each.is_leaving}
    assert leaving == {"capture", "track"}
    played.ends(0, *leaving)
    played.step()
    assert {each.stage.name for each in played.live.stages if each.alive} == {"render"}
    assert played.goes_on() and not played.said


def test_a_session_rests_after_ten_seconds_without_a_face(play: Play) -> None:
    played = play()
    face = played.live._table.metrics["track"]
    at = [one.name for one in face.values].index("face")
    values = played.rows["track"]["values"]

    def idle_after(seconds: float) -> bool:
        played.step(seconds)
        return played.live.state.options.idle

    values[at] = 1
    assert not idle_after(30)
    values[at] = 0
    assert not idle_after(IDLE_NS / SECOND_NS - 0.2) and idle_after(0.5)
    values[at] = 1
    assert not idle_after(0.1), "one glance ends it"
    values[at] = 0
    kinds: tuple[dict[str, Any], ...] = ({"record": "/out"}, {"paused": True})
    for busy in kinds:
        played.live._apply(played.live.state.changed(**busy))
        assert not idle_after(30), busy
        back: dict[str, Any] = {name: type(value)() for name, value in busy.items()}
        played.live._apply(played.live.state.changed(**back))
        assert not idle_after(5), "and the time begins anew"
    assert idle_after(6)


def test_the_figures_of_a_session_are_those_of_its_table(play: Play) -> None:
    played = play()
    for ms in (1, 2, 30):
        Histogram(played.rows["render"]["age"]).add_ns(ms * MS_NS)
    played.rows["track"]["drops"] = 3
    played.rows["render"]["recent_ns"][:3] = now_ns() - np.array([2, 1, 0]) * SECOND_NS // 50
    found = played.live.metrics().to_dict()
    track, render = found["stages"]["track"], found["stages"]["render"]
    assert (track["state"], track["dropped"], track["pid"]) == ("RUNNING", 3, os.getpid())
    assert render["fps"] == pytest.approx(50, rel=0.01)
    age = found["end_to_end"]
    assert (age["p50_ms"], age["p95_ms"]) == pytest.approx((2.0, 30.0), rel=1 / 64)


def test_a_lease_of_pictures_ends_by_itself(play: Play) -> None:
    played = play()
    played.live._apply(played.live.state.with_pictures(played.t_ns + SECOND_NS))
    ring = Session(played.live._session.name).segment(played.live.state.options.pictures)
    played.step(0.8)
    assert ring.exists()
    played.step(0.4)
    assert not ring.exists() and not played.live.state.options.pictures


def test_a_faulty_part_is_named_once(play: Play) -> None:
    played = play()
    played.rows["track"]["fault"] = b"the engine sees nothing"
    played.rows["track"]["fault_since_ns"] = played.t_ns
    played.step(1.5)
    assert not played.said
    played.step(5)
    assert played.said == ["the engine sees nothing"]


@pytest.mark.parametrize(
    ("lost", "fault", "restarts", "words"),
    [
        (0, b"", 0, ""),
        (1, b"", 0, "a file of the session is incomplete"),
        (2, b"", 0, "2 files of the session are incomplete"),
        (1, b"the engine sees nothing", 0, "the engine sees nothing: it never worked"),
        (0, b"", 1, "track failed before its first eyes: it never worked"),
    ],
)
def test_what_went_wrong_in_a_session_that_ends_well(
    play: Play, lost: int, fault: bytes, restarts: int, words: str
) -> None:
    played = play()
    played.rows["render"]["lost_outputs"] = lost
    played.rows["track"]["fault"] = fault
    played.rows["track"]["restarts"] = restarts
    played.rows["track"]["seq"] *= not restarts
    played.t_ns += 60 * SECOND_NS
    played.live._watch_faults()
    found = played.live._with_failure(Outcome(reason="finished"))
    assert (found.failure or "") == (f"finished, but {words}" if words else "")


def test_a_session_ends_by_the_first_of_signal_and_duration(play: Play) -> None:
    played = play()
    played.live._check_limits(1.0, ())
    played.t_ns += SECOND_NS - 1
    played.live._check_limits(1.0, ())
    assert played.goes_on()
    played.t_ns += 1
    played.live._check_limits(1.0, ())
    played.live._check_limits(None, (2,))
    assert "--duration" in played.outcome().reason
    other = Outcome(reason="interrupted", signum=15)
    played.live._outcome = None
    played.live._check_limits(None, (15, 2))
    assert played.outcome() == other


def exchange(played: Played, client: zmq.Socket[bytes], **message: Any) -> dict[str, Any]:
    """The answer to a request."""
    client.send(control.encode(message))

    def answer() -> bytes | None:
        played.step()
        return client.recv() if client.poll(0) else None

    return control.decode(until(answer, "an answer"))


def test_a_defect_in_a_handler_is_answered_and_the_session_goes_on(
    play: Play, monkeypatch: pytest.MonkeyPatch
) -> None:
    played = play()
    monkeypatch.setitem(requests.HANDLERS, "recentre", lambda *_: 1 // 0)
    with connected(played.dir) as client:
        answer = exchange(played, client, cmd="recentre", id=7)
        assert answer["id"] == 7 and {**answer, **INTERNAL} == answer
        assert played.told("ZeroDivisionError") == 1
        assert exchange(played, client, cmd="pause")["applied"] is True
    assert played.live.state.paused and played.goes_on()


def test_an_answer_says_whether_the_stages_have_applied_a_change(play: Play) -> None:
    played = play()
    with connected(played.dir) as client:
        assert exchange(played, client, cmd="set", set={"render.alpha_px": 9.0})["applied"] is True
        played.change(alpha_px=8.0)
        played.ends(1, "track", applied=False)
        assert exchange(played, client, cmd="stop")["ok"]
    assert played.outcome().reason == "stopped by command"


def test_files_that_are_removed_end_the_session(play: Play) -> None:
    played = play()
    for in_place in (True, False):
        assert played.goes_on()
        lock: Any = SimpleNamespace(in_place=lambda in_place=in_place: in_place)
        played.live._check_files(lock)
    assert f"{played.dir} was removed" in str(played.outcome().failure)
