"""Benchmarks on small inputs: metrics and skipped measurements."""

import itertools
from pathlib import Path

import attrs
import numpy as np
import pytest

from lfpipe.bench import live, paper_loop, pipeline, stability, synthesis, tracker
from lfpipe.bench.inputs import FrameSequence, demo_sequence, read_sequence
from lfpipe.bench.results import Results
from lfpipe.bench.runner import Variant
from lfpipe.sequence.eyes import Truth
from lfpipe.track.models import has_face_mesh
from tests.bench.inputs import inputs, wall
from tests.replay.conftest import make_sequence

# mediapipe has no FaceMesh for some Pythons and machines
PAPER = ["mediapipe, 640x480"] if has_face_mesh() else []


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> FrameSequence:
    """Stillness and half a second of motion of the demo's face, with truth."""
    return read_sequence(demo_sequence(tmp_path_factory.mktemp("sequence"), 0.5), 75)


def split(offered: object) -> tuple[dict[str, Variant], dict[str, str]]:
    items = list(offered)  # type: ignore[call-overload]
    left_out = dict(item.split(": ", 1) for item in items if isinstance(item, str))
    return {item.name: item for item in items if isinstance(item, Variant)}, left_out


def test_tracker_follows_the_demo_within_a_pixel(tmp_path: Path, sequence: FrameSequence) -> None:
    found, skipped = split(tracker.measure(inputs(wall(2, 2), tmp_path, sequence)))
    assert [name for name, one in found.items() if one.paper] == PAPER and (
        "engine mediapipe" in skipped
    ) != bool(PAPER)
    assert sequence.truth is not None and np.ptp(sequence.truth.eyes_px[61:], axis=0).max() > 5, (
        "it moves after two seconds"
    )
    metrics, repetition = found["litert, 640x480"].prepare()
    assert metrics["error"].value < 2.0
    assert repetition is not None and set(repetition()) == {"cpu_ms"}
    found, skipped = split(
        tracker.measure(inputs(wall(2, 2), tmp_path, attrs.evolve(sequence, truth=None)))
    )
    assert "tracking error" in skipped and set(found["litert, 320x240"].prepare()[0]) == {"missed"}
    vblank, skipped = split(tracker.measure(inputs(wall(2, 2), tmp_path)))
    assert "input wider than 160 px" in skipped
    with pytest.raises(ValueError, match="no face"):
        vblank["litert, 160x120"].prepare()


def test_synthesis_of_a_wall_and_what_does_not_apply(tmp_path: Path) -> None:
    found, skipped = split(synthesis.measure(inputs(wall(5, 5), tmp_path)))
    assert not skipped and [name for name, one in found.items() if one.paper] == [
        "nearest, every 2nd view"
    ]
    (near, _), (warped, repetition) = (
        found[f"{name}, every 2nd view"].prepare() for name in ("nearest", "warp2")
    )
    assert warped["psnr_db"].low > near["psnr_db"].high + 5
    assert near["jump"].value > 10 > 4 > warped["jump"].value
    assert repetition is not None and repetition()["cpu_ms"] > 0
    for rows, cols, disparity, missing, curves in (
        (5, 5, False, "warped views", {"nearest", "blend"}),
        (1, 9, True, "viewpoints off the line", {"nearest", "blend", "warp", "warp2"}),
        (1, 1, True, "error on held-out views", set()),
        (2, 2, True, "error on held-out views", set()),
    ):
        found, skipped = split(
            synthesis.measure(inputs(wall(rows, cols, disparity=disparity), tmp_path))
        )
        assert missing in skipped and {one.curve for one in found.values()} == curves


@pytest.mark.parametrize("decode", [False, True])
def test_the_loop_names_the_frame_it_shows(tmp_path: Path, decode: bool) -> None:
    video = demo_sequence(tmp_path, 0.1)  # 63 frames
    given = itertools.islice(paper_loop.frames(str(video), decode, (640, 480)), 70)
    assert [place for place, _ in given] == [*range(63), *range(7)]


def test_displayed_error_of_a_known_trace() -> None:
    """Pictures 10 ms late of eyes that move 100 px/s: 1 px behind, 0.01 views at 100 px per
    view.
    """
    t_ns = np.arange(120) * 33_333_333
    eyes = np.stack([300 + t_ns / 1e9 * 100, 240 + 0 * t_ns] * 2, axis=1).reshape(-1, 2, 2)
    truth = Truth(t_ns, eyes, np.ones(len(t_ns), bool))
    rows = []
    for ms in range(200, 3500):
        used = truth.at((ms - 10) * 1e6)
        views = [[4.0, 4 + (400 - u) / 100] for u in used[:, 0]]
        pairs = {
            name: dict(zip(("left", "right"), np.asarray(pair).tolist(), strict=True))
            for name, pair in (("eyes_used", used), ("view", views))
        }
        rows.append(
            {
                "t_presented_ns": ms * 1_000_000,
                "t_sensor_ns": 0,
                "source_seq": 0,
                "composed": True,
                **pairs,
            }
        )
    # the file starts over, and the filter has yet to follow
    wrong = {"left": [0.0, 0.0], "right": [0.0, 0.0]}
    rows += [
        row
        | {
            "source_seq": 120,
            "t_presented_ns": row["t_presented_ns"] + 10**10,  # type: ignore[operator]
            "eyes_used": wrong,
        }
        for row in rows
    ]
    mapping = 100.0, (400.0, 240.0), (9, 9)
    assert pipeline.displayed_errors(truth, rows, *mapping) == {
        "error_views": pytest.approx(0.01, rel=0.05),
        "error_px": pytest.approx(1.0, rel=0.05),
    }
    resting = Truth(t_ns, eyes, truth.visible, np.ones(len(t_ns), bool))
    assert pipeline.displayed_errors(resting, rows, *mapping)["jitter_px"] > 10


def test_extreme_cases_and_whether_they_matter(tmp_path: Path) -> None:
    """Nothing in use fails; what is not in use names the setting that reaches it; the tables can
    tell.
    """
    given = inputs(wall(3, 3), tmp_path)
    made = [
        *(
            stability.filter_table((30,), moving, frames)
            for moving, frames in itertools.product((False, True), (1, 2))
        ),
        stability.mapping_table(),
        stability.synthesis_table(given),
    ]
    judged = [(table.title, value) for table, _, _, value in Results("stability", made).judged()]
    assert not [value for _, value in judged if value.state == "failed"]
    degraded = [title for title, value in judged if value.state == "degraded" and not value.only]
    assert any(" bad frame" in title for title in degraded)


def test_a_bad_frame_is_judged_by_peak_and_duration() -> None:
    """The mean of 5 shows a fifth of it for five frames; what predicts shows more, if it lasts."""
    peak, lasts_s = stability.disturbed("mean", "wrong by half an eye distance", 30, False)
    assert peak == pytest.approx(0.1, abs=1e-9) and lasts_s == pytest.approx(5 / 30)
    once, twice = (
        stability.disturbed("predictive", "wrong by half an eye distance", 30, False, n)[0]
        for n in (1, 2)
    )
    assert once < 0.1 < 0.5 < twice, "what no head does is held back once"
    assert stability.disturbed("one-euro", "spike of 1e18 px", 30, True)[0] < 0.5


def test_a_sequence_is_read_frame_by_frame_and_a_recorded_one_will_do(tmp_path: Path) -> None:
    recorded = read_sequence(make_sequence(tmp_path / "walk", 12), 10)
    assert recorded.count == len(list(recorded.frames())) == 10 and recorded.truth is not None
    whole = read_sequence(demo_sequence(tmp_path, 0.1), 40)
    frames = list(whole.frames())
    assert whole.count == len(frames) == 40 and frames[3].any() and (frames[3] != frames[4]).any()


def test_live_cases_have_exact_views_and_a_camera_that_is_darker_costs_little() -> None:
    case = live.Case(simple=True, scale=0.4)
    same, darker, peer = (
        float(np.mean(live.differences(name, attrs.evolve(case, response=response), 10) ** 2))
        for name, response in (
            ("lfpipe", case.response),
            ("lfpipe", lambda values: 0.75 * values),
            ("DIS", lambda values: 0.75 * values),
        )
    )
    assert same < darker < 1.26 * same, "at most 1 dB"
    assert peer > 2 * darker
    near = attrs.evolve(case, baseline=0.0)
    assert live.differences("cross-fade", near, 6).std() < 0.5, "one place, one view"
