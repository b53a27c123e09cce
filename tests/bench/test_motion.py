"""Sequences of a face in known motion."""

import csv
from pathlib import Path

import cv2
import numpy as np
from click.testing import CliRunner, Result

from lfpipe.track.litert_engine import LitertEngine
from tools.make_sequence import main


def make(out: Path, *words: str) -> Result:
    return CliRunner().invoke(main, [str(out), "--rate", "10", *words])


def test_sequence_shows_the_eyes_where_the_truth_says(tmp_path: Path) -> None:
    path = tmp_path / "face.avi"
    make(path, "--seconds", "6.5", "--seed", "7")
    with path.with_suffix(".csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["source_seq"]), int(row["t_ns"])) for row in rows] == [
        (k, k * 100_000_000) for k in range(65)
    ]
    assert {row["phase"] for row in rows} == {"still", "move"}
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
        assert done.exit_code == 2
        assert message in done.stderr and "remedy" in done.stderr
