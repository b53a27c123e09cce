"""A run against a reference of other versions: differences by rounding pass with a note, others are detected. Damaged
references are compared, or refused by file, field and value.

The reference in git stands for both; what another version would have made of it is written into a copy. Real runs with OpenCV
4.11, 4.12 and 5.0 against each other are in docs/replay.md.
"""

import json
import random
import shutil
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.host.machine import OPENCV
from lfpipe.render import replay_writer
from lfpipe.render.replay_writer import PICTURES, ReplayWriter
from lfpipe.replays.compare import MOST_FIELDS, compare
from lfpipe.replays.report import REPORT, TRACE, read_trace
from lfpipe.replays.run import clear_out, update_reference
from lfpipe.sequence.packets import INDEX, PACKETS, PacketWriter, decoded, encoded, read_index
from lfpipe.transport.ring import Stamp
from tests import hostile_files as hostile
from tests import hostile_sequences

REFERENCE = Path(__file__).parent / "reference"
FRAMES = 12
Picture = np.ndarray


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """What a run would write that gives the reference's very results."""
    shutil.copytree(REFERENCE, tmp_path / "run")
    return tmp_path / "run"


def other(folder: Path, line: Callable[[dict[str, Any]], None] | None = None, machine: str = "x86_64") -> Path:
    """A copy of folder as another OpenCV made it, on that machine; line: what that does to a line of the trace."""
    copy = folder.parent / "other"
    shutil.copytree(folder, copy)
    report = json.loads((copy / "report.json").read_text())
    report["versions"] |= {OPENCV: "4.12.0.88"} | ({} if machine == "x86_64" else {"machine": machine})
    (copy / "report.json").write_text(json.dumps(report))
    lines = read_trace(copy)
    for each in lines if line else ():
        line(each)
    (copy / "trace.jsonl").write_text("".join(json.dumps(each) + "\n" for each in lines))
    return copy


def redrawn(folder: Path, draw: Callable[[Picture], Picture]) -> None:
    """Every picture of a run drawn otherwise: kept ones, and all digests."""
    kept = folder / PICTURES
    old = [(p, (kept / "frames.bin").read_bytes()[p.offset : p.offset + p.bytes]) for p in read_index(kept, complete=True)]
    shutil.rmtree(kept)
    kept.mkdir()
    writer, digests = PacketWriter(kept), {}
    for packet, data in old:
        size = np.frombuffer(data[16:24], ">u4")  # of a PNG's first chunk
        picture = draw(decoded(packet, data, int(size[0]), int(size[1]), kept))
        writer.append(encoded(picture, fast=False)[1], "png", packet.source_seq, packet.epoch, packet.t_sensor_ns, 0)
        digests[packet.source_seq] = f"{zlib.crc32(picture.data):08x}"
    writer.close()
    lines = read_trace(folder)
    for line in lines:
        line["picture"] = digests.get(line["source_seq"], f"{int(line['picture'], 16) ^ 1:08x}")
    (folder / "trace.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


def dithered(picture: Picture) -> Picture:
    """Another rounding: one value in four is one step higher or lower."""
    step = np.random.default_rng(0).choice(np.array([-1, 0, 0, 0, 0, 0, 0, 1]), picture.shape)
    return np.clip(picture.astype(int) + step, 0, 255).astype(np.uint8)


def moved(name: str, px: float) -> Callable[[dict[str, Any]], None]:
    def move(line: dict[str, Any]) -> None:
        line[name]["left"][0] += px

    return move


def test_the_same_results_of_the_same_versions_need_no_word(run: Path) -> None:
    found = compare(REFERENCE, run)
    assert found.differences == [] and found.notes == []


def test_settings_are_compared_where_they_matter(run: Path) -> None:
    def changed(**sections: dict[str, Any]) -> list[str]:
        report = json.loads((REFERENCE / "report.json").read_text())
        for section, keys in sections.items():
            report["config"][section] |= keys
        (run / "report.json").write_text(json.dumps(report))
        return [str(difference) for difference in compare(REFERENCE, run).differences]

    render = {"rate_hz": 50.0, "clock": "camera", "loop_ms": 60.0}
    assert changed(render=render, screen={"monitor": "DP-1"}, scene={"cache_dir": "/x"}) == []
    (said,) = changed(track={"filter": "mean"}, render={"rate_hz": 50.0})
    assert said == "config: track.filter: 'predictive' in the reference, 'mean' now"


def test_a_part_of_the_frames_that_differ_is_counted(run: Path) -> None:
    def move_two(line: dict[str, Any]) -> None:
        line["eyes_raw"]["left"][0] += 1.0 * (line["source_seq"] in (7, 9))

    (difference,) = compare(other(run, move_two), run).differences
    assert str(difference).startswith("eyes: frame 7: eyes_raw left") and difference.what.endswith("2 of 300 frames")


def test_other_versions_are_told_and_a_rounding_passes(run: Path) -> None:
    copy = other(run, moved("eyes_raw", 0.04))
    redrawn(copy, dithered)
    found = compare(copy, run)
    assert found.differences == [], [str(difference) for difference in found.differences]
    was, is_now = "4.12.0.88 in the reference", json.loads((run / "report.json").read_text())["versions"][OPENCV]
    assert found.notes[0] == f"compared with tolerances, not bit by bit: {OPENCV} {was}, {is_now} now"
    assert "300 of 300 digests differ, least PSNR 5" in found.notes[1]
    assert not (run / "difference").exists()


def test_the_same_rounding_is_caught_where_versions_are_equal(run: Path) -> None:
    redrawn(run, dithered)
    (difference,) = compare(REFERENCE, run).differences
    assert difference.part == "pictures" and difference.frame == 0 and "300 of 300 frames; least PSNR 5" in difference.what
    assert {path.name.rpartition("_")[2] for path in (run / "difference").iterdir()} == {
        "reference.png",
        "now.png",
        "difference.png",
    }


@pytest.mark.parametrize(
    ("change", "part", "said"),
    [
        (moved("eyes_raw", 0.06), "eyes", "eyes_raw"),
        (moved("eyes_filtered", -0.06), "eyes", "eyes_filtered"),
        (moved("eyes_used", 0.06), "eyes", "eyes_used"),
        (lambda line: line["view"]["right"].__setitem__(1, line["view"]["right"][1] + 1), "views", "view"),
    ],
)
def test_more_than_a_rounding_is_caught(run: Path, change: Callable[[dict[str, Any]], None], part: str, said: str) -> None:
    (difference,) = compare(other(run, change), run).differences
    assert difference.part == part and difference.frame == 0 and difference.what.startswith(said)
    assert "300 of 300 frames" in difference.what


def test_another_machine_may_round_more_and_flip_a_view_at_its_boundary(run: Path) -> None:
    """Found on ARM: eyes differ by up to 0.08 px, and one of 300 views flips."""

    def on_arm(line: dict[str, Any], moved_px: float = 0.08, flips: tuple[int, ...] = (7, 120)) -> None:
        line["eyes_raw"]["left"][0] += moved_px
        line["eyes_used"]["left"][0] += moved_px
        line["view"]["left"][1] += line["source_seq"] in flips

    found = compare(other(run, on_arm, "aarch64"), run)
    assert found.differences == [] and "aarch64" in found.notes[0] and "2 of 300 flipped" in found.notes[-1]
    for change in (
        lambda line: on_arm(line, moved_px=0.12, flips=()),
        lambda line: on_arm(line, moved_px=0.0, flips=(7,)),  # equal eyes, another view: the map changed
        lambda line: on_arm(line, flips=tuple(range(300))),  # all views are off by one
    ):
        shutil.rmtree(run.parent / "other")
        assert compare(other(run, change, "aarch64"), run).differences


def test_pictures_that_a_person_could_tell_apart_are_caught(run: Path) -> None:
    copy = other(run)
    redrawn(copy, lambda picture: np.where(picture < 253, picture + np.uint8(3), picture))
    (difference,) = compare(copy, run).differences
    assert difference.part == "pictures" and "least PSNR 38" in difference.what


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first frames of the project's reference."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    shutil.copytree(REFERENCE, folder)
    lines = (folder / TRACE).read_text().splitlines(keepends=True)[:FRAMES]
    (folder / TRACE).write_text("".join(lines))
    report = json.loads((folder / REPORT).read_text())
    report["counts"]["pictures"] = FRAMES
    (folder / REPORT).write_text(json.dumps(report))
    return folder


def damage(rng: random.Random, folder: Path) -> str:
    """Damages one thing of a reference; returns which."""
    kind = rng.choice(("report", "report", "trace", "trace", "index", "pictures", "picture", "no file"))
    kept = folder / "pictures"
    if kind == "report":
        (folder / REPORT).write_bytes(hostile.damaged_json(rng, json.loads((folder / REPORT).read_text())))
    elif kind in ("trace", "index"):
        path = folder / TRACE if kind == "trace" else kept / INDEX
        path.write_bytes(hostile.damaged_lines(rng, [json.loads(line) for line in path.read_text().splitlines()]))
    elif kind == "pictures":
        (kept / PACKETS).write_bytes(hostile.damaged_bytes(rng, (kept / PACKETS).read_bytes()))
    elif kind == "picture":
        found = hostile_sequences.packets(kept)
        for at in range(3):
            found[at] = (found[at][0], hostile_sequences.hostile_picture(rng, found[at][1]))
        hostile_sequences.put_packets(kept, found)
    else:
        path = rng.choice((folder / REPORT, folder / TRACE, kept / INDEX, kept / PACKETS))
        hostile.NO_FILES[kind := rng.choice(sorted(hostile.NO_FILES))](path)
    return kind


@settings(max_examples=100)
@given(seed=st.integers(0, 2**32), moved=st.booleans())
def test_a_damaged_reference_is_compared_or_refused(first: Path, seed: int, moved: bool) -> None:
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as parent:
        reference, now = Path(parent) / "ref", Path(parent) / "now"
        shutil.copytree(first, reference)
        shutil.copytree(first, now)
        if moved:  # so that pictures are looked at
            lines = [json.loads(line) for line in (now / TRACE).read_text().splitlines()]
            (now / TRACE).write_text("".join(json.dumps({**line, "picture": f"{line['picture']}x"}) + "\n" for line in lines))
        what = damage(rng, reference)
        try:
            found = compare(reference, now)
        except UserError as error:
            assert str(reference) in error.message and error.remedy and len(str(error)) <= 2000, (what, error)
        else:
            text = "".join(map(str, found.differences)) + "".join(found.notes)
            assert len(text) < 40_000
            text.encode()


def test_a_reference_with_thousands_of_other_settings_is_told_in_a_few_lines(first: Path, tmp_path: Path) -> None:
    shutil.copytree(first, tmp_path / "ref")
    report = json.loads((first / REPORT).read_text())
    report["config"] |= {"x" * 200 + str(n): {"k": "v" * 1000} for n in range(3626)}
    (tmp_path / "ref" / REPORT).write_text(json.dumps(report))
    with pytest.raises(UserError, match="bytes"):
        compare(tmp_path / "ref", first)
    report["config"] = json.loads((first / REPORT).read_text())["config"]  # keys of no effect are not compared
    report["plan"] = {f"x{n}": "v" * 50 for n in range(3626)}
    (tmp_path / "ref" / REPORT).write_text(json.dumps(report))
    found = [str(each) for each in compare(tmp_path / "ref", first).differences]
    assert len(found) == MOST_FIELDS + 1 and found[-1].endswith("more keys")


def test_results_that_are_links_go_without_what_they_lead_to(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "photo").touch()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "pictures").symlink_to(tmp_path / "mine")
    hostile.NO_FILES["link to itself"](tmp_path / "out" / REPORT)
    (tmp_path / "out" / (REPORT + ".turn")).unlink()
    clear_out(tmp_path / "out")
    assert (tmp_path / "mine" / "photo").exists() and not list((tmp_path / "out").iterdir())


def test_kept_pictures_of_two_runs_have_frames_in_common(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_writer, "KEPT_BYTES", 20_000)
    rng = np.random.default_rng(3)
    kept = []
    for run, size in enumerate((16, 24)):
        folder = tmp_path / str(run)
        folder.mkdir()
        keeping = ReplayWriter(folder, str(tmp_path), pictures=True)
        eyes = np.zeros((2, 2))
        for seq in range(64):
            picture = rng.integers(0, 256, (size, size, 3), dtype=np.uint8)
            keeping.keep(Stamp(seq + 1, seq, 0, seq, seq, seq, 0), eyes, eyes, seq, picture, composed=True)
        keeping.close()
        packets = read_index(folder / "pictures", complete=True)
        assert sum(packet.bytes for packet in packets) <= 20_000 and (folder / "last.png").exists()
        kept.append({packet.source_seq for packet in packets})
    assert kept[1] < kept[0] and 0 in kept[1] and len(kept[1]) >= 4


def test_a_link_out_of_a_reference_is_not_followed(first: Path, tmp_path: Path) -> None:
    for number, name in enumerate((REPORT, TRACE, "pictures", f"pictures/{INDEX}", f"pictures/{PACKETS}")):
        reference = tmp_path / str(number)
        shutil.copytree(first, reference)
        path = reference / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        path.symlink_to(first / name)
        with pytest.raises(UserError, match=f"{name}: a link to "):
            compare(reference, first)


def test_a_trace_that_is_not_whole_is_bad_input(first: Path, tmp_path: Path) -> None:
    shutil.copytree(first, tmp_path / "ref")
    for keep in (9, 12):
        (tmp_path / "ref" / TRACE).write_bytes(b"".join((first / TRACE).read_bytes().splitlines(keepends=True)[:keep])[:-9])
        with pytest.raises(UserError, match=f"{keep - 1} lines"):
            compare(tmp_path / "ref", first)


def test_an_update_without_room_leaves_the_reference(first: Path, tmp_path: Path) -> None:
    shutil.copytree(first, tmp_path / "ref")
    before = {path.name: path.read_bytes() for path in (tmp_path / "ref").rglob("*") if path.is_file()}
    (tmp_path / "now").mkdir()
    (tmp_path / "now" / REPORT).write_text("{}")  # no trace: as if the disk were full there
    with pytest.raises(UserError):
        update_reference(tmp_path / "ref", tmp_path / "now")
    assert {path.name: path.read_bytes() for path in (tmp_path / "ref").rglob("*") if path.is_file()} == before
    (tmp_path / ".ref.new").mkdir()  # of an update that was killed
    update_reference(tmp_path / "ref", first)
    assert sorted(path.name for path in (tmp_path / "ref").iterdir()) == ["pictures", REPORT, TRACE]
