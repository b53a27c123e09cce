"""Sequences on disk: written, cut off anywhere, damaged in every way, cut, imported and exported."""

import json
import resource
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path

import attrs
import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.open_source import open_source
from lfpipe.cli import cli
from lfpipe.errors import UserError
from lfpipe.sequence import edit
from lfpipe.sequence.eyes import read_truth
from lfpipe.sequence.folder import MANIFEST, checksum, open_sequence
from lfpipe.sequence.packets import INDEX, PACKETS, Packet, PacketWriter, decoded, encoded, read_index
from tests.world import World

NOISE = np.random.default_rng(1).integers(0, 256, (24, 32, 3), dtype=np.uint8)


def test_a_packet_without_loss_gives_its_picture_back(tmp_path: Path) -> None:
    for fast in (True, False):
        codec, data = encoded(NOISE, fast)
        packet = Packet(0, 0, 0, 1, 1, codec, 0, len(data), zlib.crc32(data))
        assert np.array_equal(decoded(packet, data, 32, 24, tmp_path), NOISE)
        with pytest.raises(UserError, match=r"frame 0: .*checksum"):
            decoded(packet, data[:-1] + bytes([data[-1] ^ 1]), 32, 24, tmp_path)
        with pytest.raises(UserError, match="31x24"):
            decoded(packet, data, 31, 24, tmp_path)


@settings(max_examples=60)
@given(sizes=st.lists(st.integers(0, 40), min_size=1, max_size=8), data=st.data())
def test_whatever_is_cut_off_the_whole_frames_before_it_are_read_and_written_on(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    writer = PacketWriter(folder)
    for seq, size in enumerate(sizes):
        writer.append(bytes([seq]) * size, "raw", seq, 0, 10 + seq, 11 + seq)
    writer.close()
    whole = list(read_index(folder, complete=True))
    assert [packet.bytes for packet in whole] == sizes
    # the index is written after the packet: a kill cuts the index anywhere, and the packets no earlier than it says
    keep = data.draw(st.integers(0, (folder / INDEX).stat().st_size))
    (folder / INDEX).write_bytes((folder / INDEX).read_bytes()[:keep])
    left = list(read_index(folder, complete=False))
    assert left == whole[: len(left)] and len(left) == (folder / INDEX).read_bytes().count(b"\n")
    again = PacketWriter(folder)
    again.append(b"more", "raw", 99, 1, 1000, 1001)
    sums = again.checksums()
    again.close()
    found = list(read_index(folder, complete=True))
    assert found[:-1] == left and found[-1].source_seq == 99
    assert sums == {name: checksum(folder / name) for name in (PACKETS, INDEX)}


def test_a_full_disk_leaves_the_frames_before_it(tmp_path: Path) -> None:
    writer = PacketWriter(tmp_path)
    writer.append(b"x" * 4000, "raw", 0, 0, 1, 1)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (6000, hard))
    try:
        with pytest.raises(OSError):
            writer.append(b"y" * 4000, "raw", 1, 0, 2, 2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    writer.append(b"z", "raw", 2, 0, 3, 3)
    writer.close()
    assert [(p.source_seq, p.bytes) for p in read_index(tmp_path, complete=True)] == [(0, 4000), (2, 1)]


def _lines(folder: Path) -> list[str]:
    return (folder / INDEX).read_text().splitlines(keepends=True)


def _without_line(folder: Path) -> None:
    lines = _lines(folder)
    (folder / INDEX).write_text("".join(lines[:7] + lines[8:]))


def _line(**changes: object) -> Callable[[Path], None]:
    """Damage to line 9 of the index: a number is a step from what was there."""

    def change(folder: Path) -> None:
        lines = _lines(folder)
        line = json.loads(lines[9])
        steps = {name: line[name] + step if isinstance(step, int) else step for name, step in changes.items()}
        lines[9] = json.dumps({**line, **steps}) + "\n"
        (folder / INDEX).write_text("".join(lines))

    return change


def _one_bit(folder: Path) -> None:
    data = bytearray((folder / PACKETS).read_bytes())
    data[len(data) // 2] ^= 1
    (folder / PACKETS).write_bytes(bytes(data))


def _manifest(**changes: object) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        manifest = json.loads((folder / MANIFEST).read_text())
        (folder / MANIFEST).write_text(json.dumps({**manifest, **changes}))

    return change


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda f: (f / PACKETS).write_bytes((f / PACKETS).read_bytes()[:-5]), r"\.bin ends after \d+ bytes, within frame 59"),
        (lambda f: (f / INDEX).write_bytes((f / INDEX).read_bytes()[:-5]), "its last line is cut off"),
        (lambda f: (f / INDEX).write_text("".join(_lines(f)[:-1])), "59 frames, but 60 were recorded"),
        (_without_line, "frame 7 is missing; frame 8 is in its place"),
        (_line(t_sensor_ns=-(10**9)), "frame 9: its time stamp .* is not after"),
        (_line(offset=1), "frame 9 does not begin where the previous frame ends"),
        *(
            (_line(**wrong), rf"frames\.jsonl:10: {said}")
            for wrong, said in (
                ({"codec": "gif"}, "codec is 'gif', expected one of jpeg, png, raw, eyes"),
                ({"offset": -(10**12)}, "offset is -9"),
                ({"bytes": -(10**12)}, "bytes is -9"),
                ({"crc32": "x"}, "crc32 is 'x'"),
                ({"epoch": 1.5}, r"epoch is 1\.5"),
                ({"more": "x"}, "unknown field 'more'"),
            )
        ),
        (_one_bit, r"frames\.bin: wrong checksum"),
        (lambda f: (f / INDEX).write_text("{}\n" * 60), r"frames\.jsonl:1: codec is missing"),
        (lambda f: (f / PACKETS).unlink(), r"frames\.bin: No such file"),
        (lambda f: (f / "truth.csv").unlink(), r"truth\.csv is missing"),
        (lambda f: (f / MANIFEST).unlink(), "manifest.json is missing"),
        (lambda f: (f / MANIFEST).write_text("["), "not valid JSON"),
        (lambda f: (f / MANIFEST).write_text("[]"), "expected a JSON object, not"),
        (_manifest(version=2), "the sequence has version 2; this lfpipe reads version 1"),
        (_manifest(width_px="wide"), "width_px is 'wide', expected a whole number"),
    ],
)
def test_every_damage_is_named(short: Path, tmp_path: Path, damage: Callable[[Path], object], said: str) -> None:
    folder = tmp_path / "seq"
    shutil.copytree(short, folder)
    open_sequence(folder)
    damage(folder)
    with pytest.raises(UserError, match=said) as caught:
        open_sequence(folder)
    assert caught.value.remedy


def test_commands_name_what_is_wrong(short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "seq"
    shutil.copytree(short, folder)
    _one_bit(folder)
    blocked = tmp_path / "file"
    blocked.write_text("")
    for args, said in (
        (("replay", folder), "wrong checksum"),
        (("replay", tmp_path / "nowhere"), "no such folder"),
        (("replay", short, "--out", blocked / "out"), "cannot be written: Not a directory"),
        (("replay", short, "--out", tmp_path), "which is not from a replay"),
        (("replay", short, "--junit", blocked / "j.xml"), "--junit"),
        (("replay", short, "--pace", "fast"), "not step, max, recorded or a rate"),
        (("replay", short, "--update"), "name it with --expect"),
        (("replay", short, "--expect", tmp_path / "none"), "cannot be read"),
        (("replay", short, "--expect", tmp_path, "--pace", "recorded"), "depend on the clock"),
        (("record", folder, "--camera", "demo"), "already exists"),
        (("sequence", "cut", short, tmp_path / "cut", "--from", "9"), "no frame from 9 s"),
        (("sequence", "import", blocked, tmp_path / "new"), "not a readable video"),
        (("sequence", "export", short, tmp_path / "v.mp4"), "not .mkv or .avi"),
    ):
        found = CliRunner().invoke(cli, [str(arg) for arg in args]).exception
        assert isinstance(found, UserError) and said in found.message + found.remedy, (args, found)


def test_bad_input_ends_with_2_and_one_message(world: World, short: Path, tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    shutil.copytree(short, folder)
    _one_bit(folder)
    done = world.run("sequence", "check", folder)
    assert done.returncode == 2 and done.stderr.count("error:") == 1 and "wrong checksum" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_cut_keeps_packets_stamps_and_truth(short: Path, tmp_path: Path) -> None:
    whole = open_sequence(short)
    assert edit.cut(whole, tmp_path / "part", 0.5, 1.0) == 15
    part = open_sequence(tmp_path / "part")
    for packet in part.packets:
        was = whole.packets[packet.seq + 15]
        assert packet.t_sensor_ns == was.t_sensor_ns and part.data(packet.seq) == whole.data(was.seq)
    truth, of_whole = read_truth(part.path), read_truth(short)
    assert truth is not None and of_whole is not None
    assert np.array_equal(truth.eyes_px, of_whole.eyes_px[15:30]) and truth.t_ns[0] == 0


def test_export_and_import_bring_the_same_pictures_back(short: Path, tmp_path: Path) -> None:
    sequence = open_sequence(short)
    edit.export(sequence, tmp_path / "v.mkv")
    assert len((tmp_path / "v.csv").read_text().splitlines()) == 61
    assert edit.from_video(tmp_path / "v.mkv", tmp_path / "back") == 60
    back = open_sequence(tmp_path / "back")
    assert all(np.array_equal(back.frame(k), sequence.frame(k)) for k in range(60))


def test_motion_jpeg_is_taken_over_as_it_is(short: Path, tmp_path: Path) -> None:
    sequence = open_sequence(short)
    size = sequence.width_px, sequence.height_px
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.CAP_OPENCV_MJPEG, cv2.VideoWriter.fourcc(*"MJPG"), 30.0, size)
    for k in range(10):
        writer.write(sequence.frame(k))
    writer.release()
    assert edit.from_video(tmp_path / "v.avi", tmp_path / "seq") == 10
    made = open_sequence(tmp_path / "seq")
    stored = (tmp_path / "v.avi").read_bytes()
    for packet in made.packets:
        assert packet.codec == "jpeg" and made.data(packet.seq).rstrip(b"\0") in stored
        assert cv2.PSNR(made.frame(packet.seq), sequence.frame(packet.seq)) > 35


def test_a_sequence_is_a_source_with_its_own_stamps(short: Path) -> None:
    camera = config.Camera(width_px=320, height_px=240)
    for pace, steps in (("recorded", None), ("max", None), ("60", 16_666_667)):
        source = open_source(f"file:{short}?loop=1&pace={pace}", camera)
        out = np.empty((240, 320, 3), np.uint8)
        taken = [source.read(out) for _ in range(61)]
        source.close()
        stamps = [frame.t_sensor_ns for frame in taken if frame]
        recorded = [packet.t_sensor_ns for packet in open_sequence(short).packets]
        if steps is None:
            assert np.array_equal(np.diff(stamps[:60]), np.diff(recorded))
        else:
            assert np.abs(np.diff(stamps) - steps).max() <= 1
        assert stamps[60] > stamps[59] and [frame.source_seq for frame in taken if frame] == list(range(61))
        assert all(bool(frame.t_read_ns) == (pace == "max") for frame in taken if frame)


def test_packets_know_plain_values_only(short: Path) -> None:
    for packet in open_sequence(short).packets:
        assert json.loads(json.dumps(attrs.asdict(packet))) == attrs.asdict(packet)
