"""Benchmarks on small inputs: metrics and skipped measurements."""

import itertools
from pathlib import Path

import attrs
import numpy as np
import pytest

from lfpipe.bench import paper_loop, pipeline, tracker
from lfpipe.bench.inputs import FrameSequence, demo_sequence, read_sequence
from lfpipe.bench.runner import Variant
from lfpipe.sequence.packets import Truth
from lfpipe.track.models import has_face_mesh
from tests.bench.inputs import inputs, wall

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
