"""Known motion, and sequences generated from it."""

import csv
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe.track.litert_engine import LitertEngine
from tools.head_path import duration_s, path_at, reach, stop, viewer_path

TOOL = Path(__file__).parents[2] / "tools" / "make_sequence.py"
HOME = (0.0, 0.0, 600.0)


def test_reach_is_at_rest_at_both_ends_and_peaks_at_the_speed_asked() -> None:
    piece = reach(HOME, (240.0, 0.0, 600.0), 450.0)
    t = np.linspace(0, piece.duration_s, 2001)
    x = piece.position_mm(t)[:, 0]
    speed = np.gradient(x, t)
    assert (x[0], x[-1]) == (0.0, pytest.approx(240.0)) and speed.max() == pytest.approx(
        450.0, rel=1e-3
    )
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
    assert set(phases) == {
        "still",
        "reach",
        "sway",
        "stop",
        "approach",
        "retreat",
        "leave",
        "enter",
    }
    assert np.allclose(places[[0, -1]], HOME)


def make(out: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, TOOL, out, "--rate", "10", *words],
        capture_output=True,
        text=True,
        check=False,
    )


def test_sequence_shows_the_eyes_where_the_truth_says(tmp_path: Path) -> None:
    path = tmp_path / "face.avi"
    make(path, "--seconds", "6.5", "--seed", "7")
    with path.with_suffix(".csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["source_seq"]), int(row["t_ns"])) for row in rows] == [
        (k, k * 100_000_000) for k in range(65)
    ]
    assert {row["phase"] for row in rows} == {"still", "reach"}
    truth = np.array(
        [
            [[row["left_x_px"], row["left_y_px"]], [row["right_x_px"], row["right_y_px"]]]
            for row in rows
        ],
        float,
    )
    assert np.ptp(truth[:, 0, 0]) > 100 and np.all(truth[:, 0, 0] > truth[:, 1, 0])
    video = cv2.VideoCapture(str(path))
    engine = LitertEngine()
    pictures = [np.asarray(video.read()[1], np.uint8) for _ in rows]
    assert pictures[0].shape == (480, 640, 3) and not video.read()[0]
    faces = [engine.detect(picture) for picture in pictures]
    errors = [
        np.inf if face is None else face.eyes_px - eyes
        for face, eyes in zip(faces, truth, strict=True)
    ]
    assert float(np.sqrt(np.square(errors).sum(axis=-1).mean())) < 1.5
    for seed in (7, 8):  # of the noise
        make(tmp_path / "other.avi", "--seconds", "0.3", "--seed", str(seed))
        assert np.array_equal(
            cv2.VideoCapture(str(tmp_path / "other.avi")).read()[1], pictures[0]
        ) == (seed == 7)


def test_a_portrait_without_a_face_is_named(tmp_path: Path) -> None:
    portrait = tmp_path / "portrait.png"
    for content, message in (
        (b"no picture", "not a picture"),
        (np.full((200, 200, 3), 99, np.uint8), "no face found"),
    ):
        portrait.write_bytes(
            content if isinstance(content, bytes) else cv2.imencode(".png", content)[1].tobytes()
        )
        done = make(tmp_path / "out.avi", "--portrait", str(portrait))
        assert done.returncode == 2
        assert message in done.stderr and "remedy" in done.stderr and "Traceback" not in done.stderr
