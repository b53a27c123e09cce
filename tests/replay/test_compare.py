"""A run against a reference of other versions: differences by rounding pass with a note, others are
detected. Damaged references are compared, or refused by file, field and value.

The reference in git stands for both; what another version would have made of it is written into a
copy. Real runs with OpenCV 4.11, 4.12 and 5.0 against each other are in docs/replay.md.
"""

import json
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from lfpipe.host.worker import OPENCV
from lfpipe.render import listeners
from lfpipe.render.listeners import PICTURES, ReplayWriter
from lfpipe.render.presenter import TrackedEyes
from lfpipe.replays.compare import check_reference, compare
from lfpipe.replays.run import (
    REPORT,
    TRACE,
    about_scene,
    clear_out,
    digests,
    read_report,
    read_trace,
    update_reference,
)
from lfpipe.sequence.packets import PACKETS, PacketWriter, decoded, encoded, read_index
from lfpipe.transport.ring import Stamp
from tests.render import rendered
from tests.support.refusal import refusal

REFERENCE = Path(__file__).parent / "reference"
FRAMES = 12
Picture = np.ndarray
Change = Callable[[dict[str, Any]], object]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """What a run would write that gives the reference's very results."""
    return shutil.copytree(REFERENCE, tmp_path / "run")


def write_trace(folder: Path, lines: list[dict[str, Any]]) -> None:
    (folder / TRACE).write_text("".join(json.dumps(line) + "\n" for line in lines))
    change_report(folder, lambda report: report.update(digests=digests(lines)))


def change_report(folder: Path, change: Change) -> None:
    report = json.loads((folder / REPORT).read_text())
    change(report)
    (folder / REPORT).write_text(json.dumps(report))


def setting(part: str, key: str, value: object) -> Change:
    return lambda report: report[part].update({key: value})


def other(folder: Path, line: Change = lambda row: None, machine: str = "x86_64") -> Path:
    """A copy of folder as another OpenCV made it, on that machine; line: what that does to a line
    of the trace.
    """
    copy = shutil.copytree(folder, folder.parent / "other", dirs_exist_ok=True)
    change_report(
        copy, lambda report: report["versions"].update({OPENCV: "4.12.0.88", "machine": machine})
    )
    lines = read_trace(copy)
    for row in lines:
        line(row)
    write_trace(copy, lines)
    return copy


def redrawn(folder: Path, draw: Callable[[Picture], Picture]) -> None:
    """Every picture of a run drawn otherwise: kept ones, and all digests."""
    kept = folder / PICTURES
    old = [
        (p, (kept / PACKETS).read_bytes()[p.offset : p.offset + p.bytes]) for p in read_index(kept)
    ]
    shutil.rmtree(kept)
    kept.mkdir()
    writer = PacketWriter(kept)
    digests = {}
    for packet, data in old:
        size = np.frombuffer(data[16:24], ">u4")  # of a PNG's first chunk
        picture = draw(decoded(packet, data, int(size[0]), int(size[1]), kept))
        writer.append(
            encoded(picture),
            "png",
            packet.source_seq,
            packet.epoch,
            packet.t_sensor_ns,
            0,
        )
        digests[packet.source_seq] = f"{zlib.crc32(picture.data):08x}"
    writer.close()
    lines = read_trace(folder)
    for line in lines:
        line["picture"] = digests.get(line["source_seq"], f"{int(line['picture'], 16) ^ 1:08x}")
    write_trace(folder, lines)


def dithered(picture: Picture) -> Picture:
    """Another rounding: one value in four is one step higher or lower."""
    step = np.random.default_rng(0).choice(np.array([-1, 0, 0, 0, 0, 0, 0, 1]), picture.shape)
    return np.asarray(np.clip(picture.astype(int) + step, 0, 255), np.uint8)


def moved(px: float, *names: str, flips: Callable[[int], bool] = lambda seq: False) -> Change:
    """Moves eyes by px, and views of some frames by one."""

    def move(line: dict[str, Any]) -> None:
        for name in names:
            line[name]["left"][0] += px
        line["view"]["left"][1] += flips(line["source_seq"])

    return move


def test_renamed_inputs_compare_equal_and_only_relevant_settings_count(
    run: Path,
) -> None:
    change_report(run, setting("scene", "name", "copy"))
    same = compare(REFERENCE, run)
    assert same.differences == [] and same.notes == []

    def changed(**sections: dict[str, Any]) -> list[str]:
        change_report(
            run,
            lambda report: [
                report["config"][section].update(keys) for section, keys in sections.items()
            ],
        )
        return [str(difference) for difference in compare(REFERENCE, run).differences]

    render = {"rate_hz": 50.0, "clock": "camera", "device_latency_ms": 60.0}
    assert changed(render=render, screen={"monitor": "DP-1"}, scene={"cache_dir": "/x"}) == []
    assert changed(track={"filter": "mean"}) == [
        "config: track.filter: 'predictive' in the reference, 'mean' now"
    ]


def test_another_scene_or_sequence_is_refused_and_other_views_are_named(run: Path) -> None:
    field = rendered.field(3, 3)
    one, turned = about_scene(field), about_scene(attrs.evolve(field, views=field.views[:, ::-1]))
    change_report(run, setting("scene", "order", turned["order"]))
    assert one["views"] == turned["views"] and one["order"] != turned["order"]
    assert [str(each) for each in compare(REFERENCE, run).differences] == [
        "scene: the same views in another order"
    ]
    change_report(run, setting("scene", "views", one["views"]))
    assert [str(each) for each in compare(REFERENCE, run).differences] == [
        "scene: the pictures of its views differ"
    ]
    for part, key, was in (("scene", "rows", 5), ("sequence", "frames", 300)):
        change_report(run, setting(part, key, 9))
        said = f"made with another {part}: {key} {was} in the reference, 9 now"
        assert said in str(refusal(check_reference, REFERENCE, read_report(run)))
        shutil.copy(REFERENCE / REPORT, run / REPORT)


def test_other_versions_are_reported_and_rounding_passes(run: Path) -> None:
    copy = other(run, moved(0.04, "eyes_raw"))
    redrawn(copy, dithered)
    found = compare(copy, run)
    assert found.differences == [], [str(difference) for difference in found.differences]
    was = "4.12.0.88 in the reference"
    is_now = json.loads((run / REPORT).read_text())["versions"][OPENCV]
    assert (
        found.notes[0] == f"compared with tolerances, not bit for bit: {OPENCV} {was}, {is_now} now"
    )
    assert "300 of 300 digests differ, least PSNR 5" in found.notes[1]
    assert not (run / "difference").exists()
    # a person could tell them apart
    redrawn(copy, lambda picture: np.where(picture < 253, picture + np.uint8(3), picture))
    (difference,) = compare(copy, run).differences
    assert difference.part == "pictures" and "least PSNR 3" in difference.what


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (moved(0.09, "eyes_raw", "eyes_filtered", "eyes_used"), ""),  # as between x86-64 and ARM
        (moved(0.12, "eyes_raw"), "eyes: frame 0: eyes_raw left"),
        (moved(-0.12, "eyes_filtered"), "eyes: frame 0: eyes_filtered left"),
        (moved(0.12, "eyes_used"), "eyes: frame 0: eyes_used left"),
        # equal eyes, another view: the map changed
        (moved(0.0, flips=(7, 120).__contains__), "views: frame 7: view left"),
    ],
)
def test_only_rounding_passes_on_another_machine(run: Path, change: Change, said: str) -> None:
    found = compare(other(run, change, "aarch64"), run)
    assert bool(found.differences) == bool(said) and said in "".join(
        map(str, found.differences[:1])
    )
    assert "aarch64" in found.notes[0]


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first frames of the project's reference."""
    folder = shutil.copytree(REFERENCE, tmp_path_factory.mktemp("runs") / "run")
    write_trace(folder, read_trace(folder)[:FRAMES])
    change_report(folder, setting("counts", "pictures", FRAMES))
    return folder


def test_what_is_not_whole_or_leads_elsewhere_is_refused(first: Path, tmp_path: Path) -> None:
    reference = shutil.copytree(first, tmp_path / "ref")
    for keep in (9, 12):
        (reference / TRACE).write_bytes(
            b"".join((first / TRACE).read_bytes().splitlines(keepends=True)[:keep])[:-9]
        )
        assert f"{keep - 1} lines" in str(refusal(compare, reference, first))
    (reference / TRACE).unlink()
    (reference / TRACE).symlink_to(first / TRACE)
    assert "trace.jsonl: a link to " in str(refusal(compare, reference, first))


def test_only_results_are_cleared_and_links_are_none(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / REPORT).touch()
    for name in ("photo", "pictures/photo"):
        (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "out" / name).write_text("mine")
        assert name in str(refusal(clear_out, tmp_path / "out"))
        (tmp_path / "out" / name).unlink()
    (tmp_path / "out" / "difference").symlink_to(tmp_path / "mine")
    assert "difference" in str(refusal(clear_out, tmp_path / "out"))
    (tmp_path / "out" / "difference").unlink()
    clear_out(tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())


def test_kept_pictures_of_two_runs_have_frames_in_common(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listeners, "STORED_BYTES", 20_000)
    rng = np.random.default_rng(3)
    kept = []
    for size in (16, 24):
        folder = tmp_path / str(size)
        folder.mkdir()
        keeping = ReplayWriter(folder, str(tmp_path), True, pytest.fail)
        for seq in range(64):
            picture = rng.integers(0, 256, (size, size, 3), dtype=np.uint8)
            stamp = Stamp(seq + 1, seq, 0, seq, seq, seq, 0)
            eyes = TrackedEyes(rendered.record(), stamp, seq)
            keeping.handed_over(rendered.presentation(eyes=eyes, picture=picture))
        keeping.close()
        packets = read_index(folder / PICTURES)
        assert sum(packet.bytes for packet in packets) <= 20_000 and (folder / "last.png").exists()
        kept.append({packet.source_seq for packet in packets})
    assert kept[1] < kept[0] and 0 in kept[1] and len(kept[1]) >= 4


def test_an_update_that_fails_keeps_the_reference(first: Path, tmp_path: Path) -> None:
    reference = shutil.copytree(first, tmp_path / "ref")
    (tmp_path / "now").mkdir()
    (tmp_path / "now" / REPORT).write_text("{}")  # no trace: as if the disk were full there
    refusal(update_reference, reference, tmp_path / "now")
    assert compare(reference, first).differences == []
    change_report(reference, lambda report: report.update(pace="max"))
    update_reference(reference, first)
    assert sorted(path.name for path in reference.iterdir()) == ["pictures", REPORT, TRACE]
    assert json.loads((reference / REPORT).read_text())["pace"] == "step"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["now", "ref"]


def test_pictures_that_differ_in_one_colour_have_other_digests(tmp_path: Path) -> None:
    writer = ReplayWriter(tmp_path, str(tmp_path), False, pytest.fail)
    digests = set()
    for number, colour in enumerate([(0, 0, 0), *np.eye(3).tolist()]):
        eyes = TrackedEyes(rendered.record(), Stamp(number + 1, number, 0, 0, 0, 0, 0), 0)
        shown = rendered.presentation(eyes=eyes, picture=np.full((8, 8, 3), colour, np.uint8))
        writer.handed_over(shown)
        digests.add(shown.more["picture"])
    assert len(digests) == 4
