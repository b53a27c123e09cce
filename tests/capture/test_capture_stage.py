"""The stage capture in the test's own process, on a clock and with a source as a test wants."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from lfpipe.capture import stage
from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.open_source import CameraLost
from lfpipe.capture.stage import COVERED_NS, IDLE_NS, LATE_PERIODS, CaptureStage
from lfpipe.config import Camera, SessionOptions
from lfpipe.config.session_options import CameraViewer
from lfpipe.files.codecs import BrokenFrame
from lfpipe.sequence.recorder import Recordable
from lfpipe.transport import ring
from lfpipe.transport.ring import MS_NS, SECOND_NS, Stamp, StampKind
from lfpipe.transport.status import State
from tests.support.recorded import Recorded, recorded

Call = Callable[[], object]
JPEG = np.arange(9, dtype=np.uint8)
PERIOD_NS = SECOND_NS // 30
NOISE = np.random.default_rng(1).integers(0, 256, (480, 640, 3), np.uint8)


class Source:
    """What `read` gives: a step in frames since the last frame, or an exception; calls are made
    between. Then it ends. t_ns: its clock, by which a camera's frame takes its time.
    """

    def __init__(self, live: bool) -> None:
        self.info = SourceInfo("camera:made", (640, 480), 30.0, live=live)
        self.given: list[int | Exception | Call] = []
        self.seq = -1
        self.picture = NOISE
        self.t_ns = SECOND_NS
        self.closed = 0

    def read(self, out: np.ndarray) -> Frame | None:
        item: int | Exception | Call | None = None
        while self.given and callable(item := self.given.pop(0)):
            item()
        if item is None or callable(item):
            return None
        live = self.info.live
        self.t_ns += PERIOD_NS * live
        if isinstance(item, Exception):
            raise item
        self.seq += item
        out[:] = self.picture
        t_sensor_ns = self.t_ns - 20 * MS_NS if live else 2 * SECOND_NS + self.seq * PERIOD_NS
        return Frame(self.seq, t_sensor_ns, self.t_ns * live, JPEG, StampKind.END_OF_FRAME)

    def wait(self, until_ns: int) -> bool:
        """Time passes until then."""
        self.t_ns = max(self.t_ns, until_ns)
        return True

    def close(self) -> None:
        self.closed += 1


class Recorder:
    """Keeps what is recorded."""

    def __init__(self) -> None:
        self.kept: list[Recordable] = []
        self.active = True
        self.closed = 0

    def add(self, frame: Recordable, wait: bool) -> None:
        self.kept.append(frame)

    def handle(self, message: Any) -> None: ...

    def report(self) -> None: ...

    def close(self) -> None:
        self.closed += 1


@attrs.define
class Captured:
    """A stage with its source and its recorder."""

    context: Recorded
    source: Source
    recorder: Recorder = attrs.field(factory=Recorder)

    def run(
        self, *given: int | Exception | Call, while_paused: Callable[[int], object] = bool
    ) -> list[Stamp]:
        """What is published while the source gives that."""
        self.source.given += given
        recorder: Any = self.recorder
        capture = CaptureStage(self.context, "made", Camera(), "frames", recorder)
        frames = ring.Reader(self.context.spec.session.segment("frames"))
        out = np.empty(frames.shape, np.uint8)
        read: list[Stamp] = []

        def wait(until_ns: int) -> bool:
            while (stamp := frames.read_next(out)) is not None:
                read.append(stamp)
            while_paused(until_ns)
            return self.source.wait(until_ns)

        self.context.clock = wait
        with closing(capture):
            capture.run()
        wait(0)
        frames.close()
        return read


Capture = Callable[[bool], Captured]


@pytest.fixture
def capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Capture]:
    with ExitStack() as stack:

        def begin(live: bool) -> Captured:
            options = SessionOptions(viewer=CameraViewer(source="made", rate_hz=30.0))
            context = stack.enter_context(recorded(tmp_path, monkeypatch, "capture", options))
            made = Captured(context, Source(live))
            monkeypatch.setattr(stage, "open_source", lambda *_, **__: made.source)
            monkeypatch.setattr(stage, "now_ns", lambda: made.source.t_ns)
            return made

        yield begin


def test_frames_of_a_camera_are_published_counted_and_recorded(capture: Capture) -> None:
    made = capture(True)
    stamps = made.run(1, 1, 3)
    assert [(one.source_seq, one.epoch, one.kind) for one in stamps] == [
        (0, 0, 2),
        (1, 0, 2),
        (4, 0, 2),
    ]
    assert all(one.t_read_ns - one.t_sensor_ns == 20 * MS_NS for one in stamps)
    row = made.context.row
    assert (row["seq"], row["source_seq"], row["drops"]) == (3, 4, 2), "two were lost on the way"
    assert [(one.source_seq, one.t_sensor_ns, one.codec) for one in made.recorder.kept] == [
        (one.source_seq, one.t_sensor_ns, "jpeg") for one in stamps
    ]
    assert made.recorder.kept[0].data == JPEG.tobytes()
    assert (made.source.closed, made.recorder.closed) == (1, 1)
    (opened,) = made.context.emitted
    assert opened == {
        "topic": "source",
        "name": "camera:made",
        "rate_hz": 30.0,
        "live": True,
        "notes": [],
    }


def test_a_camera_that_is_lost_and_back_begins_another_epoch(capture: Capture) -> None:
    made = capture(True)
    states: list[int] = []
    look: Call = lambda: states.append(made.context.row["state"])  # noqa: E731
    stamps = made.run(1, CameraLost("gone"), look, TimeoutError(), 1, look)
    assert [one.epoch for one in stamps] == [0, 1]
    assert states == [State.READY, State.RUNNING]
    lost, back = (one for one in made.context.emitted if one["topic"] == "camera")
    assert (lost["lost"], lost["why"], back["lost"]) == (True, "gone", False)
    assert back["away_s"] == pytest.approx(2 / 30, abs=0.01)
    assert [text.split(" after")[0] for text in made.context.notices()] == [
        "gone; camera lost, trying again",
        "camera:made is back",
    ]


def test_after_a_sleep_of_the_machine_begins_another_epoch(
    capture: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    woke = iter([False, True, False])
    watch = type("Watch", (), {"woke": lambda self: next(woke)})
    monkeypatch.setattr(stage, "SleepWatch", watch)
    assert [one.epoch for one in capture(True).run(1, 1, 1)] == [0, 1, 1]


def test_paused_a_camera_is_read_and_nothing_published(capture: Capture) -> None:
    made = capture(True)
    stamps = made.run(1, lambda: made.context.hear(paused=True), 1, 1)
    assert len(stamps) == 1 and made.context.row["left_out"] == 2
    assert made.context.row["config_rev"] == 2 and len(made.recorder.kept) == 1


def test_a_recording_stands_still_while_paused(capture: Capture) -> None:
    made = capture(False)
    begun: list[int] = []

    def pause() -> None:
        begun.append(made.source.t_ns)
        made.context.hear(paused=True)

    def wait(until_ns: int) -> bool:
        if made.context.paused and made.source.wait(made.source.t_ns + SECOND_NS // 10):
            made.context.hear(paused=made.source.t_ns < begun[0] + SECOND_NS // 2)
        return True

    stamps = made.run(1, 1, pause, *[1] * 9, while_paused=wait)
    assert [one.source_seq for one in stamps] == [0, 1, *range(3, 11)], "one was under way"
    row = made.context.row
    assert row["drops"] + row["left_out"] == 1
    moved_ns = stamps[-1].t_sensor_ns - (2 * SECOND_NS + 10 * PERIOD_NS)
    assert 0.3 < moved_ns / SECOND_NS < 0.6, "and so did its clock"


def test_while_nobody_looks_eight_frames_a_second_are_enough(capture: Capture) -> None:
    made = capture(True)
    stamps = made.run(lambda: made.context.hear(idle=True), *[1] * 60)
    gaps = np.diff([one.t_sensor_ns for one in stamps])
    assert gaps.min() >= IDLE_NS and len(stamps) >= 59, "a camera is read as often"


def test_broken_frames_are_counted_and_told_of_ever_less_often(capture: Capture) -> None:
    made = capture(False)
    broken = [BrokenFrame("v.avi: frame cannot be decoded", "") for _ in range(5)]
    stamps = made.run(1, *broken, 1)
    assert [one.source_seq for one in stamps] == [0, 1]
    assert made.context.row["drops"] == 5
    assert [text.partition("(")[2] for text in made.context.notices()] == [
        "",
        "2 so far)",
        "4 so far)",
    ]


def test_frames_of_a_recording_come_when_they_are_due_or_are_late(capture: Capture) -> None:
    made = capture(False)
    late = LATE_PERIODS + 2
    stamps = made.run(1, 1, lambda: made.source.wait(made.source.t_ns + late * PERIOD_NS), *[1] * 8)
    assert [one.source_seq for one in stamps][:2] == [0, 1]
    row = made.context.row
    assert 0 < row["drops"] <= late + 1 and row["seq"] == len(stamps)
    assert all(one.t_sensor_ns == 2 * SECOND_NS + one.source_seq * PERIOD_NS for one in stamps)


def test_a_covered_camera_is_noticed_after_a_second(capture: Capture) -> None:
    made = capture(True)
    made.source.picture = np.full_like(NOISE, 30)
    covered: list[int] = []
    look: Call = lambda: covered.append(made.context.row["covered"])  # noqa: E731
    frames = COVERED_NS // PERIOD_NS + 2
    uncover: Call = lambda: setattr(made.source, "picture", NOISE)  # noqa: E731
    made.run(*[1] * (frames - 6), look, *[1] * 8, look, uncover, 1, look)
    assert covered == [0, 1, 0]
