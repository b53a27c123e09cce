"""Recordings as sources, with real encoders and decoders."""

import shutil
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.file_source import FileSource
from lfpipe.capture.open_source import check_source, open_source
from lfpipe.capture.recordings import natural_key
from lfpipe.capture.spec import FileSpec
from lfpipe.errors import UserError

SIZE = (64, 48)
CAMERA = config.Camera(width_px=SIZE[0], height_px=SIZE[1], rate_hz=50.0)


def picture(index: int) -> np.ndarray:
    """A frame that encodes its number: its grey is 10 * index + 5."""
    return np.full((SIZE[1], SIZE[0], 3), 10 * index + 5, np.uint8)


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "six.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"HFYU"), 25.0, SIZE)
    for index in range(6):
        writer.write(picture(index))
    writer.release()
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "pictures"
    path.mkdir()
    for index in range(12):
        cv2.imwrite(str(path / f"frame{index}.png"), picture(index))
    (path / "notes.txt").write_text("no picture")
    return path


def numbers(source: FileSource, out: np.ndarray) -> list[int]:
    seen = []
    while source.read(out) is not None:
        seen.append(int(out.mean()) // 10)
    return seen


def test_a_video_once(video: Path) -> None:
    source = FileSource(FileSpec(video, loop=False), CAMERA)
    assert (source.info.width_px, source.info.height_px, source.info.rate_hz, source.info.live) == (*SIZE, 25.0, False)
    assert source.info.notes == ()
    assert numbers(source, np.zeros((SIZE[1], SIZE[0], 3), np.uint8)) == list(range(6))


def test_a_folder_in_natural_order(folder: Path) -> None:
    source = FileSource(FileSpec(folder, loop=False), CAMERA)
    assert source.info.rate_hz == 50.0
    assert any("50 Hz" in note for note in source.info.notes)
    assert numbers(source, np.zeros((SIZE[1], SIZE[0], 3), np.uint8)) == list(range(12))


def test_natural_order() -> None:
    names = ["a²", "F1.png", "f9.png", "f10.png", "f10b.png", "²1.png"]
    assert sorted(reversed(names), key=natural_key) == names


@pytest.mark.parametrize(("pace", "rate"), [("recorded", 25.0), (30.0, 30.0), (0.5, 0.5)])
def test_looped_frames_keep_counting_and_never_drift(video: Path, pace: float | str, rate: float) -> None:
    source = FileSource(FileSpec(video, loop=True, pace=pace), CAMERA)
    out = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    frames, shown = [], []
    for _ in range(20):
        frames.append(source.read(out))
        shown.append(int(out.mean()) // 10)
    assert shown == [k % 6 for k in range(20)]
    assert [frame.source_seq for frame in frames] == list(range(20))
    assert all(frame.t_read_ns == 0 for frame in frames)
    for k, frame in enumerate(frames):
        assert abs(frame.t_sensor_ns - frames[0].t_sensor_ns - k * 1e9 / rate) <= 4


def test_max_pace_is_due_now(video: Path) -> None:
    source = FileSource(FileSpec(video, pace="max"), CAMERA)
    out = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    for _ in range(8):
        before = time.monotonic_ns()
        frame = source.read(out)
        assert before <= frame.t_sensor_ns <= time.monotonic_ns()


@pytest.mark.parametrize("kind", ["video", "folder"])
def test_other_sizes_are_scaled_and_said(kind: str, request: pytest.FixtureRequest) -> None:
    path = request.getfixturevalue(kind)
    source = FileSource(FileSpec(path, loop=False), config.Camera(width_px=100, height_px=90))
    assert any("64x48 are scaled to 100x75, with black bars above and below" in note for note in source.info.notes)
    out = np.zeros((90, 100, 3), np.uint8)
    source.read(out)
    assert (out[8:82] == 5).all() and not out[:7].any() and not out[83:].any()


def test_frames_go_straight_into_a_slot(video: Path, folder: Path) -> None:
    """A slot is a view of foreign memory; its neighbours stay unchanged."""
    for path in (video, folder):
        memory = np.full((3, SIZE[1], SIZE[0], 3), 77, np.uint8)
        FileSource(FileSpec(path), CAMERA).read(memory[1])
        assert (memory[1] == 5).all() and (memory[[0, 2]] == 77).all()


def test_what_is_wrong_with_a_file(tmp_path: Path, folder: Path) -> None:
    text = tmp_path / "text.mp4"
    text.write_text("not a readable video")
    empty = tmp_path / "empty"
    empty.mkdir()
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"\x89PNG and nothing more")
    for path, says in (
        (tmp_path / "gone.mp4", "no such file"),
        (text, "not a readable video"),
        (empty, "without pictures"),
        (broken, "not a readable picture"),
    ):
        with pytest.raises(UserError, match=says) as told:
            check_source(f"file:{path}", CAMERA)
        assert str(path) in told.value.message and told.value.remedy


def test_a_looped_file_that_goes_away_says_so(folder: Path) -> None:
    source = FileSource(FileSpec(folder), CAMERA)
    shutil.rmtree(folder)
    with pytest.raises(UserError, match=r"frame0\.png"):
        source.read(np.zeros((SIZE[1], SIZE[0], 3), np.uint8))


@pytest.mark.parametrize(("kind", "size"), [("video", (270, 480)), ("pictures", (640, 360))])
def test_a_circle_stays_a_circle(kind: str, size: tuple[int, int], tmp_path: Path) -> None:
    frame = np.full((size[1], size[0], 3), 60, np.uint8)
    cv2.circle(frame, (size[0] // 2, size[1] // 2), 100, (255, 255, 255), -1)
    path = tmp_path / "round.avi"
    if kind == "pictures":
        path = tmp_path / "round.png"
        cv2.imwrite(str(path), frame)
    else:
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"HFYU"), 25.0, size)
        writer.write(frame)
        writer.release()
    out = np.zeros((480, 640, 3), np.uint8)
    open_source(f"file:{path}?loop=0", config.Camera()).read(out)
    rows, cols = np.nonzero((out > 150).all(axis=2))
    assert abs(np.ptp(rows) - np.ptp(cols)) <= 1
    assert abs(rows.mean() - 239.5) < 1 and abs(cols.mean() - 319.5) < 1
