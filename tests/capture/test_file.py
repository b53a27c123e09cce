"""Recordings as sources, with real encoders and decoders: in order, on time, JPEGs passed on
unchanged.
"""

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.open_source import check_source, clock_of, open_source
from lfpipe.capture.recordings import FileSource
from lfpipe.capture.spec import FileSpec
from lfpipe.config.session_options import CameraViewer, Live, Lossless
from tests.capture.made_files import CAMERA, SHAPE, SIZE, flat, jpeg, seen, video


@pytest.fixture(params=["video", "folder"])
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Six frames."""
    if request.param == "video":
        return video(tmp_path / "six.avi", "HFYU", [flat(index) for index in range(6)])
    path = tmp_path / "pictures"
    path.mkdir()
    for index in range(6):
        # from 7 to 12: numbers, not text
        cv2.imwrite(str(path / f"frame{7 + index}.png"), flat(index))
    (path / "notes.txt").write_text("no picture")
    return path


def test_frames_come_in_order_into_a_slot_of_foreign_memory(recording: Path) -> None:
    source = FileSource(FileSpec(recording, loop=False), CAMERA)
    memory = np.full((3, *SHAPE), 77, np.uint8)
    assert (source.info.size_px, source.info.live) == (SIZE, False)
    own_rate = recording.suffix == ".avi"
    assert (
        source.info.rate_hz == (25.0 if own_rate else 50.0)
        and any("50 Hz" in note for note in source.info.notes) != own_rate
    )
    numbers = []
    while (frame := source.read(memory[1])) is not None:
        assert not source.info.jpeg and frame.packet is None
        numbers.append(int(memory[1].mean()) // 10)
    assert numbers == list(range(6)) and (memory[[0, 2]] == 77).all()


@pytest.mark.parametrize(("pace", "rate"), [("recorded", 25.0), (0.5, 0.5), ("max", None)])
def test_looped_frames_keep_counting_and_never_drift(
    tmp_path: Path, pace: float | Literal["recorded", "max"], rate: float | None
) -> None:
    path = video(tmp_path / "six.avi", "HFYU", [flat(index) for index in range(6)])
    source = FileSource(FileSpec(path, loop=True, pace=pace), CAMERA)
    out = np.zeros(SHAPE, np.uint8)
    frames, numbers = [], []
    for _ in range(20):
        frame = source.read(out)
        assert frame is not None
        frames.append(frame)
        numbers.append(int(out.mean()) // 10)
    assert numbers == [k % 6 for k in range(20)] and [frame.source_seq for frame in frames] == list(
        range(20)
    )
    assert all(frame.t_read_ns == 0 for frame in frames)
    for k, frame in enumerate(frames):
        due_ns = frame.t_sensor_ns - frames[0].t_sensor_ns
        assert abs(due_ns - k * 1e9 / rate) <= 4 if rate else due_ns < 10**10, (
            "at full pace each is due now"
        )


@pytest.mark.parametrize(("kind", "size"), [("video", (270, 480)), ("pictures", (640, 360))])
def test_other_sizes_are_scaled_in_proportion_and_reported(
    kind: str, size: tuple[int, int], tmp_path: Path
) -> None:
    frame = np.full((size[1], size[0], 3), 60, np.uint8)
    cv2.circle(frame, (size[0] // 2, size[1] // 2), 100, (255, 255, 255), -1)
    path = tmp_path / "round.png"
    if kind == "video":
        path = video(tmp_path / "round.avi", "HFYU", [frame])
    else:
        cv2.imwrite(str(path), frame)
    out = np.full((480, 640, 3), 99, np.uint8)
    source = open_source(f"file:{path}?loop=0", config.Camera())
    source.read(out)
    rows, cols = np.nonzero((out > 150).all(axis=2))
    assert abs(np.ptp(rows) - np.ptp(cols)) <= 1
    assert abs(rows.mean() - 239.5) < 1 and abs(cols.mean() - 319.5) < 1
    assert not out[0, 0].any() and any("with black bars" in note for note in source.info.notes)


def test_motion_jpeg_in_a_file(tmp_path: Path) -> None:
    path = video(tmp_path / "v.avi", "MJPG", [seen(jpeg(index)) for index in range(5)])
    text = f"file:{path}?pace=max"
    assert check_source(text, CAMERA) == CameraViewer(
        source=text, rate_hz=25.0, jpeg_px=SIZE, name=text.partition("?")[0]
    )
    assert (clock_of(text), clock_of(f"file:{path}")) == (Lossless(), Live())
    stored = path.read_bytes()
    source = FileSource(FileSpec(path), CAMERA)
    out = np.zeros(SHAPE, np.uint8)
    assert source.info.jpeg and source.info.rate_hz == 25.0
    packets, stamps = [], []
    for _ in range(12):  # it starts over twice
        frame = source.read(out)
        assert frame is not None and frame.packet is not None and frame.packet.tobytes() in stored
        assert np.array_equal(out, seen(frame.packet.tobytes()))
        packets.append(frame.packet.tobytes())
        stamps.append(frame.t_sensor_ns)
    assert (
        len(set(packets[:5])) == 5
        and packets[5:10] == packets[:5]
        and set(np.diff(stamps)) == {40_000_000}
    )
