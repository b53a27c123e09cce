"""Sequences and traces as MCAP: read by the library mcap, taken back byte for byte, refused by name where damaged."""

import base64
import json
import random
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from lfpipe.cli.sequence import sequence as command
from lfpipe.cli.trace import trace as trace_command
from lfpipe.errors import UserError
from lfpipe.files import mcap_file
from lfpipe.sequence.folder import open_sequence
from lfpipe.sequence.mcap_folder import export_mcap, import_mcap
from tests.hostile_sequences import FRAMES, STEP_NS, made_sequence, picture


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_sequence(tmp_path_factory.mktemp("made") / "walk")


@pytest.fixture(scope="module")
def exported(folder: Path) -> Path:
    out = folder.parent / "walk.mcap"
    assert export_mcap(open_sequence(folder), out) == FRAMES
    return out


def messages(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """topic -> (log time, JSON) of every message, as the library reads it."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None and schema.encoding == "jsonschema" and channel.message_encoding == "json"
            assert json.loads(schema.data)["title"] == schema.name
            found.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    return found


def test_the_library_reads_frames_eyes_and_latency(exported: Path, folder: Path) -> None:
    found = messages(exported)
    assert {topic: len(each) for topic, each in found.items()} == {
        "/camera": 4, "/camera/raw": 2, "/camera/stamps": FRAMES, "/eyes": FRAMES, "/latency": FRAMES
    }  # fmt: skip
    sequence = open_sequence(folder)
    times = [t_ns for t_ns, _ in found["/camera/stamps"]]
    assert np.diff(times).tolist() == [STEP_NS] * (FRAMES - 1) and times[0] > 1_700_000_000_000_000_000
    (t_ns, first), *_ = found["/camera"]
    assert first["format"] == "jpeg" and first["timestamp"]["sec"] == t_ns // 10**9
    data = np.frombuffer(base64.b64decode(first["data"]), np.uint8)
    np.testing.assert_array_equal(cv2.imdecode(data, cv2.IMREAD_COLOR), sequence.frame(0))
    raw = found["/camera/raw"][0][1]
    pixels = np.frombuffer(base64.b64decode(raw["data"]), np.uint8).reshape(raw["height"], raw["step"] // 3, 3)
    assert raw["encoding"] == "bgr8"
    np.testing.assert_array_equal(pixels, picture(1))
    assert found["/eyes"][2][1]["source_seq"] == 2 and found["/latency"][0][1]["capture_ms"] == 5e-6


def test_import_gives_every_byte_back(exported: Path, folder: Path, tmp_path: Path) -> None:
    assert import_mcap(exported, tmp_path / "back") == FRAMES
    names = sorted(path.name for path in folder.iterdir())
    assert sorted(path.name for path in (tmp_path / "back").iterdir()) == names
    for name in names:
        assert (tmp_path / "back" / name).read_bytes() == (folder / name).read_bytes(), name
    with pytest.raises(UserError, match="already exists"):
        import_mcap(exported, tmp_path / "back")


def test_the_commands_take_it_by_its_suffix(folder: Path, tmp_path: Path) -> None:
    runner = CliRunner()
    out = tmp_path / "x.mcap"
    assert "6 frames" in runner.invoke(command, ["export", str(folder), str(out)]).output
    assert out.stat().st_mode & 0o777 == 0o600
    again = runner.invoke(command, ["export", str(folder), str(out)])
    assert isinstance(again.exception, UserError) and "already exists" in again.exception.message
    assert "6 frames" in runner.invoke(command, ["import", str(out), str(tmp_path / "y")]).output
    assert "all readable" in runner.invoke(command, ["check", str(tmp_path / "y")]).output


def test_any_damage_is_refused_and_leaves_nothing(exported: Path, folder: Path, tmp_path: Path) -> None:
    good = exported.read_bytes()
    rng = random.Random(7)
    refused = 0
    for case in range(120):
        data = bytearray(good)
        if case % 3 == 0:
            data = data[: rng.randrange(len(data))]
        else:
            for _ in range(rng.choice((1, 3, 40))):
                data[rng.randrange(len(data))] = rng.randrange(256)
        path, out = tmp_path / "damaged.mcap", tmp_path / f"out{case}"
        path.write_bytes(data)
        try:
            import_mcap(path, out)
        except UserError as error:
            refused += 1
            assert error.remedy and not out.exists()
        else:  # what nobody reads was hit: the summary at the end
            assert all((out / each.name).read_bytes() == each.read_bytes() for each in folder.iterdir())
    assert refused > 60


def written(path: Path, *records: tuple[str, Any], compression: CompressionType = CompressionType.NONE) -> Path:
    """A file of these messages."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        for topic, content in records:
            channel = writer.register_channel(topic, "json", 0)
            writer.add_message(channel, 0, json.dumps(content).encode(), 0)
        writer.finish()
    return path


def test_files_of_others_are_refused_by_name(tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    line = json.loads((folder / "frames.jsonl").read_text().splitlines()[0])
    for number, (path, why) in enumerate(
        (
            (tmp_path / "nothing.mcap", "cannot be read"),
            (folder / "frames.bin", "not a whole MCAP file"),
            (Path("/dev/zero"), "cannot be read"),
            (written(tmp_path / "empty.mcap"), "contains no manifest.json"),
            (written(tmp_path / "other.mcap", ("/tf", {})), "contains no manifest.json"),
            (written(tmp_path / "zip.mcap", ("/camera", {"data": "0" * 10**6}), compression=CompressionType.ZSTD), "compressed"),
            (written(tmp_path / "stamps.mcap", ("/camera/stamps", line)), "has stamps but no picture"),
            (written(tmp_path / "list.mcap", ("/camera", [])), "contains no picture"),
            (written(tmp_path / "fields.mcap", ("/camera", {"data": ""}), ("/camera/stamps", {"seq": 1})), "frame 0"),
            (written(tmp_path / "swapped.mcap", ("/camera", {"data": "AAAA"}), ("/camera/stamps", line)), "after recording"),
        )
    ):
        with pytest.raises(UserError) as caught:
            import_mcap(path, tmp_path / f"out{number}")
        assert why in caught.value.message and caught.value.remedy and not (tmp_path / f"out{number}").exists()
    monkeypatch.setattr(mcap_file.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match="not installed") as caught:
        export_mcap(open_sequence(folder), tmp_path / "x.mcap")
    assert "lfpipe[media]" in caught.value.remedy


def test_a_trace_becomes_pictures_and_latency(tmp_path: Path) -> None:
    times = {f"t_{name}_ns": 10**9 + k * 10**6 for k, name in enumerate(("sensor", "read", "tracked", "started", "composed"))}
    sides = {"left": [1.0, 2.0], "right": [3.0, 4.0]}
    line = {"seq": 0, "source_seq": 5, "epoch": 0, **times, "t_presented_ns": 10**9 + 9 * 10**6, "face": True}
    line |= {"eyes_raw": sides, "eyes_used": sides, "view": sides, "method": "warp", "level": 0, "composed": True}
    source = tmp_path / "trace.jsonl"
    source.write_text((json.dumps(line) + "\n") * 3)
    done = CliRunner().invoke(trace_command, ["convert", str(source), str(tmp_path / "trace.mcap")])
    assert "3 pictures" in done.output, done
    found = messages(tmp_path / "trace.mcap")
    assert found["/picture"][0] == (10**9 + 9 * 10**6, line)
    assert found["/latency"][0][1] == {"capture_ms": 1, "track_ms": 1, "render_ms": 1, "display_ms": 5, "age_ms": 9}
