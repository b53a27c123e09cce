"""Sources of JPEGs pass on each one unchanged, with the frame that it decodes to."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.file_source import FileSource
from lfpipe.capture.spec import FileSpec
from lfpipe.capture.v4l2_device import Mode
from tests.capture.fake_camera import FakeCamera, source

SIZE = (96, 64)
CAMERA = config.Camera(width_px=SIZE[0], height_px=SIZE[1])


def jpeg(index: int, size: tuple[int, int] = SIZE) -> bytes:
    """A unique frame."""
    picture = cv2.GaussianBlur(np.random.default_rng(index).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8), (5, 5), 0)
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 70 + index])[1].tobytes()


def seen(packet: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(packet, np.uint8), cv2.IMREAD_COLOR)


def webcam(packets: list[bytes]) -> FakeCamera:
    return FakeCamera(Mode("MJPG", *SIZE, 0, 30.0), packets)


def test_a_cameras_jpegs_come_out_as_they_went_in() -> None:
    start, padded = jpeg(0), jpeg(2) + bytes(100)  # some drivers fill their buffer up; what is behind the picture stays too
    sent = [start, jpeg(1), padded]
    camera = source(webcam(sent), width_px=SIZE[0], height_px=SIZE[1])
    assert camera.info.jpeg
    out = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    for packet in sent[1:]:
        frame = camera.read(out)
        assert frame is not None and frame.packet is not None and frame.packet.tobytes() == packet
        assert np.array_equal(out, seen(packet))


def test_a_packet_that_is_no_jpeg_is_passed_over() -> None:
    camera = source(webcam([jpeg(0), b"", b"\0" * 500, jpeg(3)[:40], jpeg(4)]), width_px=SIZE[0], height_px=SIZE[1])
    out = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    frame = camera.read(out)
    assert frame is not None and frame.packet is not None and frame.packet.tobytes() == jpeg(4) and frame.source_seq == 3


def test_frames_of_another_size_are_scaled_and_their_packets_stay(tmp_path: Path) -> None:
    camera = source(webcam([jpeg(0), jpeg(1)]), width_px=48, height_px=32)
    out = np.zeros((32, 48, 3), np.uint8)
    frame = camera.read(out)
    assert frame is not None and frame.packet is not None and frame.packet.tobytes() == jpeg(1)
    assert np.array_equal(out, cv2.resize(seen(jpeg(1)), (48, 32), interpolation=cv2.INTER_LINEAR))


def test_motion_jpeg_in_a_file(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.CAP_OPENCV_MJPEG, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, SIZE)
    for index in range(5):
        writer.write(seen(jpeg(index)))
    writer.release()
    stored = path.read_bytes()
    source = FileSource(FileSpec(path, loop=True), CAMERA)
    assert source.info.jpeg and source.info.rate_hz == 25.0
    out, packets, stamps = np.zeros((SIZE[1], SIZE[0], 3), np.uint8), [], []
    for _ in range(12):  # it starts over twice
        frame = source.read(out)
        assert frame is not None and frame.packet is not None and frame.packet.tobytes() in stored
        assert np.array_equal(out, seen(frame.packet.tobytes()))
        packets.append(frame.packet.tobytes())
        stamps.append(frame.t_sensor_ns)
    assert len(set(packets[:5])) == 5 and packets[5:10] == packets[:5]
    assert set(np.diff(stamps)) == {40_000_000}


def test_a_folder_of_jpegs(tmp_path: Path) -> None:
    for index in range(3):
        (tmp_path / f"{index}.jpg").write_bytes(jpeg(index))
    (tmp_path / "3.jpg").write_bytes(jpeg(3, (48, 32)))
    source = FileSource(FileSpec(tmp_path, loop=False), CAMERA)
    assert source.info.jpeg
    out = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    for index in range(3):
        frame = source.read(out)
        assert frame is not None and frame.packet is not None and frame.packet.tobytes() == jpeg(index)
        assert np.array_equal(out, seen(jpeg(index)))
    frame = source.read(out)
    assert frame is not None and frame.packet is None, "another size than the others cannot be stored beside them"


@pytest.mark.parametrize("name", ["v.avi", "p.png"])
def test_other_sources_have_none(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if path.suffix == ".avi":
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"HFYU"), 25.0, SIZE)
        writer.write(seen(jpeg(0)))
        writer.release()
    else:
        cv2.imwrite(str(path), seen(jpeg(0)))
    source = FileSource(FileSpec(path), CAMERA)
    frame = source.read(np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    assert not source.info.jpeg and frame is not None and frame.packet is None
