"""The stage track in the test's own process: frames go in, records and words come out."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from lfpipe.config import QualityLevel, SessionOptions
from lfpipe.config.session_options import CameraViewer
from lfpipe.eyes import EYES
from lfpipe.track import eye_tracker, stage
from lfpipe.track.engine import Face
from lfpipe.transport import ring
from lfpipe.transport.ring import Stamp
from tests.support.recorded import Recorded, recorded
from tests.track.test_eye_tracker import FACE

MS = 1_000_000


class Engine:
    """Gives a face where the frame's first value says so. rotated_deg: what it finds then."""

    name, model, rotated_deg = "made", "none", 0

    def __init__(self) -> None:
        self.resets = self.seen = 0
        self.overtake: Any = lambda: None

    def detect(self, image: np.ndarray) -> Face | None:
        self.seen += 1
        has_face = bool(image[0, 0, 0])
        self.overtake()
        return FACE if has_face else None

    def examine(self, image: np.ndarray) -> None: ...

    def reset(self) -> None:
        self.resets += 1

    def close(self) -> None: ...


class Tracked:
    """A stage with its writer of frames and a reader of its eyes."""

    def __init__(self, context: Recorded, engine: Engine) -> None:
        self.context, self.engine = context, engine
        self.frames = ring.Writer(context.spec.session.segment("frames"))
        self.eyes = ring.Reader(context.spec.session.segment("eyes"))

    def frame(self, seq: int, face: bool = True) -> None:
        self.frames.begin()[0, 0, 0] = face
        self.frames.publish(seq, 10**9 + seq * 33 * MS, 10**9 + seq * 33 * MS + 5, kind=2)

    def run(self, *steps: Any) -> list[tuple[Stamp, np.ndarray]]:
        """What is published in these steps: a frame's number, or a call."""
        found: list[tuple[Stamp, np.ndarray]] = []
        out = np.zeros((), EYES)

        def collect() -> None:
            while (stamp := self.eyes.read_next(out)) is not None:
                found.append((stamp, out.copy()))

        for one in steps:
            self.context.steps += [
                partial(self.frame, one) if isinstance(one, int) else one,
                collect,
            ]
        stage.main(self.context)
        return found


@pytest.fixture
def tracked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Tracked]:
    engine = Engine()
    monkeypatch.setattr(eye_tracker, "make_engine", lambda *_: engine)
    viewer = CameraViewer(source="demo", rate_hz=30.0)
    with recorded(tmp_path, monkeypatch, "track", SessionOptions(viewer=viewer)) as context:
        made = Tracked(context, engine)
        yield made
        made.frames.close()
        made.eyes.close()


def test_each_frame_has_its_record_with_its_stamps(tracked: Tracked) -> None:
    found = tracked.run(4, 5, lambda: tracked.frame(6, face=False))
    assert [stamp.source_seq for stamp, _ in found] == [4, 5, 6]
    for stamp, record in found:
        t_ns = 10**9 + stamp.source_seq * 33 * MS
        assert (stamp.t_sensor_ns, stamp.t_read_ns, stamp.kind, stamp.epoch) == (
            t_ns,
            t_ns + 5,
            2,
            0,
        )
        assert record["t_tracked_ns"] > stamp.t_read_ns
    assert [int(record["face"]) for _, record in found] == [1, 1, 0]
    np.testing.assert_allclose(found[0][1]["raw_px"], FACE.eyes_px)
    faces = [one for one in tracked.context.emitted if one["topic"] == "face"]
    assert faces == [
        {"topic": "face", "found": True, "source_seq": 4},
        {"topic": "face", "found": False, "source_seq": 6},
    ]
    row = tracked.context.row
    assert (row["seq"], row["source_seq"], row["drops"], row["left_out"]) == (3, 6, 0, 0)
    assert (row["face"], row["outputs_ok"], row["outputs_faulty"]) == (0, 2, 0)


def test_at_a_lower_level_every_second_frame_is_left_out_unmeasured(tracked: Tracked) -> None:
    level = QualityLevel(number=1, words="", method="warp", rate_hz=60.0, every=2)
    found = tracked.run(lambda: tracked.context.hear(level=level), 4, 5, 6, 7)
    assert [stamp.source_seq for stamp, _ in found] == [4, 6]
    row = tracked.context.row
    assert (tracked.engine.seen, row["left_out"], row["source_seq"]) == (2, 2, 7)
    assert row["config_rev"] == 2, "acknowledged"


def test_a_frame_that_is_overwritten_while_it_is_measured_is_lost(tracked: Tracked) -> None:
    def overtake() -> None:
        tracked.engine.overtake = lambda: None
        for seq in range(5, 5 + tracked.frames.slots):
            tracked.frame(seq)

    tracked.engine.overtake = overtake
    found = tracked.run(4, lambda: None)
    last = 4 + tracked.frames.slots
    assert [stamp.source_seq for stamp, _ in found] == [last]
    row = tracked.context.row
    assert (row["seq"], row["drops"]) == (1, tracked.frames.slots), "it and those between"


def test_recentre_chooses_the_face_again_and_is_answered(tracked: Tracked) -> None:
    tracked.run(4, lambda: tracked.context.hear("recentre"), 5)
    assert tracked.engine.resets == 1
    assert tracked.context.asked == [{"cmd": "executed", "number": 7, "ok": True}]


def test_a_face_that_is_not_upright_is_named_once(tracked: Tracked) -> None:
    tracked.engine.rotated_deg = 90
    faceless = [partial(tracked.frame, seq, face=False) for seq in range(3)]
    tracked.run(*faceless)
    assert tracked.context.notices() == ["a face is visible, but not upright: set camera.rotate=90"]


def test_an_engine_that_returns_nonsense_is_reported(
    tracked: Tracked, monkeypatch: pytest.MonkeyPatch
) -> None:
    nonsense = attrs.evolve(FACE, confidence=np.nan)
    monkeypatch.setattr(tracked.engine, "detect", lambda image: nonsense)
    tracked.run(4, 5)
    row = tracked.context.row
    assert row.record["fault"].item() == b"engine made returned an impossible face"
    assert (row["outputs_ok"], row["outputs_faulty"]) == (0, 2)
