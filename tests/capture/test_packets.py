"""A camera of JPEGs passes on each one unchanged, with the frame that it decodes to."""

import cv2
import numpy as np

from lfpipe.capture.v4l2_device import Mode
from tests.capture.fake_camera import FakeCamera, source
from tests.capture.made_files import SHAPE, SIZE, jpeg, seen


def webcam(packets: list[bytes]) -> FakeCamera:
    return FakeCamera(Mode("MJPG", *SIZE, 0, 30.0), packets)


def test_a_cameras_jpegs_come_out_as_they_went_in() -> None:
    start, padded = jpeg(0), jpeg(2) + bytes(100)  # some drivers fill their buffer up; what is behind the picture stays too
    sent = [start, jpeg(1), padded]
    camera = source(webcam(sent), width_px=SIZE[0], height_px=SIZE[1])
    assert camera.info.jpeg
    out = np.zeros(SHAPE, np.uint8)
    for packet in sent[1:]:
        frame = camera.read(out)
        assert frame is not None and frame.packet is not None and frame.packet.tobytes() == packet
        assert np.array_equal(out, seen(packet))


def test_a_packet_that_is_no_jpeg_is_passed_over() -> None:
    camera = source(webcam([jpeg(0), b"", b"\0" * 500, jpeg(3)[:40], jpeg(4)]), width_px=SIZE[0], height_px=SIZE[1])
    out = np.zeros(SHAPE, np.uint8)
    frame = camera.read(out)
    assert frame is not None and frame.packet is not None and frame.packet.tobytes() == jpeg(4) and frame.source_seq == 3


def test_frames_of_another_size_are_scaled_and_their_packets_stay() -> None:
    camera = source(webcam([jpeg(0), jpeg(1)]), width_px=32, height_px=24)
    out = np.zeros((24, 32, 3), np.uint8)
    frame = camera.read(out)
    assert frame is not None and frame.packet is not None and frame.packet.tobytes() == jpeg(1)
    assert np.array_equal(out, cv2.resize(seen(jpeg(1)), (32, 24), interpolation=cv2.INTER_LINEAR))
