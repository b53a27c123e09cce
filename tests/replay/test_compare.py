"""A run against a reference of other versions: differences by rounding pass with a note, others are detected.

The reference in git stands for both; what another version would have made of it is written into a copy. Real runs with OpenCV
4.11, 4.12 and 5.0 against each other are in docs/replay.md.
"""

import json
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfpipe.errors import UserError
from lfpipe.host.machine import OPENCV, versions
from lfpipe.render.replay_writer import PICTURES
from lfpipe.replays.compare import LEAST_DB, compare, likeness_db
from lfpipe.replays.report import read_trace
from lfpipe.sequence.packets import PacketWriter, decoded, encoded, read_index

REFERENCE = Path(__file__).parent / "reference"
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


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda f: (f / "trace.jsonl").write_text("".join((f / "trace.jsonl").read_text().splitlines(True)[:200])), "200 lines"),
        (lambda f: (f / "trace.jsonl").write_bytes((f / "trace.jsonl").read_bytes()[:-9]), "299 lines"),
        (lambda f: (f / "trace.jsonl").unlink(), "No such file"),
        (lambda f: (f / "report.json").write_text('{"format": 2}'), "version 2, this lfpipe reads 1"),
        (lambda f: (f / "report.json").write_text("{"), "not valid JSON"),
        (lambda f: (f / "pictures" / "frames.bin").write_bytes(b""), "ends after 0 bytes"),
    ],
)
def test_a_damaged_reference_is_bad_input(run: Path, damage: Callable[[Path], object], said: str) -> None:
    copy = other(run)
    redrawn(copy, dithered)
    damage(copy)
    with pytest.raises(UserError, match=said) as told:
        compare(copy, run)
    assert told.value.remedy


def test_the_limit_lies_where_it_is_said() -> None:
    grey = np.full((100, 100, 3), 100, np.uint8)
    almost = grey.copy()
    almost[:80] += 1  # mean square 0.8, 49.1 dB
    assert likeness_db(grey, almost) < LEAST_DB == 50.0 < likeness_db(grey, dithered(grey))


def test_versions_are_those_of_what_is_installed() -> None:
    assert versions()[OPENCV].startswith(cv2.__version__.split("-")[0])
