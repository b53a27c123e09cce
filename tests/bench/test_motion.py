"""Known motion, and sequences generated from it."""

import csv
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe.bench.motion import duration_s, path_at, reach, stop, viewer_path
from lfpipe.track.litert_engine import LitertEngine

TOOL = Path(__file__).parents[2] / "tools" / "make_sequence.py"
HOME = (0.0, 0.0, 600.0)


def test_reach_is_at_rest_at_both_ends_and_peaks_at_the_speed_asked() -> None:
    piece = reach(HOME, (240.0, 0.0, 600.0), 450.0)
    t = np.linspace(0, piece.duration_s, 2001)
    x = piece.position_mm(t)[:, 0]
    speed = np.gradient(x, t)
    assert (x[0], x[-1]) == (0.0, pytest.approx(240.0)) and speed.max() == pytest.approx(450.0, rel=1e-3)
    assert speed[0] < 2 and speed[-1] < 2


def test_stop_arrives_at_full_speed_and_stands_within_the_braking_time() -> None:
    piece = stop(HOME, (200.0, 0.0, 600.0), 400.0, brake_s=0.06)
    earlier, before, end = piece.position_mm(piece.duration_s - np.array([0.061, 0.06, 0.0]))[:, 0]
    assert (before - earlier) / 1e-3 == pytest.approx(400.0, rel=1e-6)
    assert end == pytest.approx(200.0) and end - before == pytest.approx(12.0)


def test_the_path_is_continuous_and_has_every_phase() -> None:
    path = viewer_path(600.0, 320.0)
    places, phases = path_at(path, np.arange(-1, duration_s(path) + 1, 1 / 1000))
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= 0.4501 + 1e-3
    assert set(phases) == {"still", "reach", "sway", "stop", "approach", "retreat", "leave", "enter"}
    assert np.allclose(places[[0, -1]], HOME)


def run(out: Path, seconds: float, seed: int) -> None:
    options = ["--rate", "10", "--seconds", str(seconds), "--seed", str(seed)]
    subprocess.run([sys.executable, TOOL, out, *options], check=True, capture_output=True)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sequence") / "face.avi"
    run(out, 6.5, 7)
    return out


def test_sequence_shows_the_eyes_where_the_truth_says(sequence: Path) -> None:
    with sequence.with_suffix(".csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["source_seq"]) for row in rows] == list(range(65))
    assert [int(row["t_ns"]) for row in rows[:2]] == [0, 100_000_000]
    assert {row["phase"] for row in rows} == {"still", "reach"}
    truth = np.array([[[row["left_x_px"], row["left_y_px"]], [row["right_x_px"], row["right_y_px"]]] for row in rows], float)
    assert np.ptp(truth[:, 0, 0]) > 100 and np.all(truth[:, 0, 0] > truth[:, 1, 0])
    video, engine, errors = cv2.VideoCapture(str(sequence)), LitertEngine(), []
    for eyes in truth:
        good, picture = video.read()
        assert good and picture.shape == (480, 640, 3)
        face = engine.detect(picture)
        assert face is not None
        errors.append(face.eyes_px - eyes)
    assert not video.read()[0]
    assert float(np.sqrt(np.square(errors).sum(axis=-1).mean())) < 1.5


def test_the_seed_is_that_of_the_noise(sequence: Path, tmp_path: Path) -> None:
    first = cv2.VideoCapture(str(sequence)).read()[1]
    for seed in (7, 8):
        run(tmp_path / "other.avi", 0.3, seed)
        assert np.array_equal(cv2.VideoCapture(str(tmp_path / "other.avi")).read()[1], first) == (seed == 7)


def test_a_portrait_without_a_face_is_named(tmp_path: Path) -> None:
    portrait = tmp_path / "portrait.png"
    for content, message in ((b"no picture", "not a picture"), (np.full((200, 200, 3), 99, np.uint8), "no face found")):
        portrait.write_bytes(content if isinstance(content, bytes) else cv2.imencode(".png", content)[1].tobytes())
        command = [sys.executable, TOOL, tmp_path / "out.avi", "--portrait", portrait]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert message in done.stderr and "remedy" in done.stderr and "Traceback" not in done.stderr
