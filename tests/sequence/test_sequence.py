"""Sequences on disk: written, cut off anywhere, cut, imported and played. `messages.py`
names every damage.
"""

import json
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.open_source import open_source
from lfpipe.sequence.folder import MANIFEST, cut, open_sequence
from lfpipe.sequence.packets import (
    INDEX,
    PACKETS,
    Packet,
    PacketWriter,
    Truth,
    decoded,
    encoded,
    read_index,
    read_packet,
    read_truth,
)
from tests.capture.made_files import video
from tests.support.examples import examples
from tests.support.films import write_stamped
from tests.support.hostile_sequences import FRAMES, typed
from tests.support.processes import largest_file
from tests.support.refusal import refusal

NOISE = np.random.default_rng(1).integers(0, 256, (24, 32, 3), dtype=np.uint8)


def test_a_packet_without_loss_gives_its_picture_back(tmp_path: Path) -> None:
    for codec, data in (("raw", NOISE.tobytes()), ("png", encoded(NOISE))):
        packet = Packet(
            seq=0,
            source_seq=0,
            epoch=0,
            t_sensor_ns=1,
            t_read_ns=1,
            codec=codec,
            offset=0,
            bytes=len(data),
            crc32=zlib.crc32(data),
        )
        (tmp_path / PACKETS).write_bytes(data)
        assert np.array_equal(
            decoded(packet, read_packet(tmp_path, packet), 32, 24, tmp_path), NOISE
        )
        assert "frame 0: not a whole" in str(refusal(decoded, packet, data, 31, 24, tmp_path))
        (tmp_path / PACKETS).write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
        assert "frame 0: its bytes were changed" in str(refusal(read_packet, tmp_path, packet))


@examples(60)
@given(sizes=st.lists(st.integers(0, 40), min_size=1, max_size=8), data=st.data())
def test_whatever_is_cut_off_the_whole_frames_before_it_are_read_and_written_on(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    writer = PacketWriter(folder)
    for seq, size in enumerate(sizes):
        writer.append(bytes([seq]) * size, "raw", seq, 0, 10 + seq, 11 + seq)
    writer.close()
    whole = list(read_index(folder))
    assert [packet.bytes for packet in whole] == sizes
    # the index is written after the packet: a kill cuts the index anywhere, and the packets no
    # earlier than it says
    keep = data.draw(st.integers(0, (folder / INDEX).stat().st_size))
    (folder / INDEX).write_bytes((folder / INDEX).read_bytes()[:keep])
    left = list(read_index(folder))
    assert left == whole[: len(left)] and len(left) == (folder / INDEX).read_bytes().count(b"\n")
    again = PacketWriter(folder)
    assert (folder / PACKETS).stat().st_size == sum(packet.bytes for packet in left)
    again.append(b"more", "raw", 99, 1, 1000, 1001)
    again.close()
    found = list(read_index(folder))
    assert found[:-1] == left and found[-1].source_seq == 99
    assert (folder / PACKETS).stat().st_size == found[-1].offset + 4


def test_a_full_disk_leaves_the_frames_before_it(tmp_path: Path) -> None:
    writer = PacketWriter(tmp_path)
    writer.append(b"x" * 4000, "raw", 0, 0, 1, 1)
    with largest_file(6000), pytest.raises(OSError):
        writer.append(b"y" * 4000, "raw", 1, 0, 2, 2)
    writer.append(b"z", "raw", 2, 0, 3, 3)
    writer.close()
    assert [(p.source_seq, p.bytes) for p in read_index(tmp_path)] == [
        (0, 4000),
        (2, 1),
    ]
    assert (tmp_path / PACKETS).stat().st_size == 4001


def test_a_cut_keeps_packets_stamps_and_truth_and_is_json_for_every_reader(
    whole: Path, tmp_path: Path
) -> None:
    sequence = open_sequence(whole)
    assert cut(sequence, tmp_path / "part", 0.05, float("inf")) == 4
    part = open_sequence(tmp_path / "part")
    assert part.lost == sequence.lost == 0
    offset = FRAMES - 4
    for packet in part.packets:
        was = sequence.packets[packet.seq + offset]
        assert packet.t_sensor_ns == was.t_sensor_ns and part.data(packet.seq) == sequence.data(
            was.seq
        )
    truth, of_whole = read_truth(part.path), read_truth(whole)
    assert (
        truth is not None
        and of_whole is not None
        and np.array_equal(truth.eyes_px, of_whole.eyes_px[offset:])
    )
    manifest = json.loads((part.path / MANIFEST).read_text(), parse_constant=pytest.fail)
    assert manifest["cut_from"]["end_s"] == pytest.approx(5 / 30, abs=1e-3)


def test_import_brings_the_same_pictures_back_and_motion_jpeg_unchanged(
    whole: Path, tmp_path: Path
) -> None:
    sequence = open_sequence(whole)
    frames = [sequence.frame(k) for k in range(FRAMES)]
    video(tmp_path / "v.mkv", "FFV1", frames)
    stored = video(tmp_path / "v.avi", "MJPG", frames).read_bytes()
    for name, codec in (("v.mkv", "png"), ("v.avi", "jpeg")):
        typed("import", tmp_path / name, tmp_path / codec)
        back = open_sequence(tmp_path / codec)
        assert len(back.packets) == FRAMES and back.packets.codecs == {codec}
        for k in range(FRAMES):
            if codec == "png":
                assert np.array_equal(back.frame(k), sequence.frame(k))
            else:
                assert (
                    back.data(k).rstrip(b"\0") in stored
                    and cv2.PSNR(back.frame(k), sequence.frame(k)) > 35
                )


def test_import_keeps_the_stamps_of_a_clip_whose_rate_varies(tmp_path: Path) -> None:
    stamps_ms = np.cumsum([0, *[33] * 10, 500, *[100] * 5, *[17] * 9])
    frames = [np.full((48, 64, 3), 5 * k, np.uint8) for k in range(len(stamps_ms))]
    write_stamped(tmp_path / "clip.mp4", frames, stamps_ms)
    typed("import", tmp_path / "clip.mp4", tmp_path / "out")
    packets = open_sequence(tmp_path / "out").packets
    read_ms = np.array([packet.t_sensor_ns for packet in packets]) / 1e6
    assert np.abs(read_ms - stamps_ms).max() <= 1


@pytest.mark.parametrize("pace", ["recorded", "max", "60"])
def test_a_sequence_is_a_source_with_its_own_stamps(whole: Path, pace: str) -> None:
    source = open_source(
        f"file:{whole}?loop=1&pace={pace}", config.Camera(width_px=64, height_px=48)
    )
    out = np.empty((48, 64, 3), np.uint8)
    frames = [frame for frame in (source.read(out) for _ in range(FRAMES + 1)) if frame]
    source.close()
    stamps = [frame.t_sensor_ns for frame in frames]
    recorded = [packet.t_sensor_ns for packet in open_sequence(whole).packets]
    if pace == "60":
        assert np.abs(np.diff(stamps) - 16_666_667).max() <= 1
    else:
        assert np.array_equal(np.diff(stamps[:FRAMES]), np.diff(recorded))
    assert stamps[FRAMES] > stamps[FRAMES - 1] and [frame.source_seq for frame in frames] == list(
        range(FRAMES + 1)
    )
    assert all(bool(frame.t_read_ns) == (pace == "max") for frame in frames)


@given(st.integers(0, 1_000_000_000), st.floats(-50, 50), st.floats(-50, 50))
def test_truth_lies_on_the_line_between_frames_where_the_eyes_are_visible(
    t_ns: int, x_px: float, y_px: float
) -> None:
    ends = np.array(
        [[[0.0, 0.0], [10.0, 0.0]], [[x_px, y_px], [10.0 + x_px, y_px]], [[0.0, 0.0], [1.0, 1.0]]]
    )
    truth = Truth(np.array([0, 1_000_000_000, 1_000_000_010]), ends, np.array([True, True, False]))
    at = truth.at(t_ns)
    assert truth.sees(t_ns) and np.allclose(
        at, ends[0] + t_ns / 1e9 * (ends[1] - ends[0]), atol=1e-9
    )
    assert truth.error_px(np.add(at, [3.0, 4.0]), t_ns) == pytest.approx(5.0)
    assert np.array_equal(truth.at([-1, 2_000_000_000]), ends[[0, -1]])
    hidden_ns = [-1, 1_000_000_005, 1_000_000_010, 1_000_000_011]
    assert (
        not truth.sees(hidden_ns).any()
        and np.isnan(truth.error_px(np.zeros((4, 2, 2)), hidden_ns)).all()
    )
