"""The second stream of a recording: opened with its grid, cut with the first, checked with it."""

import json
from pathlib import Path

import attrs
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.cli import cli
from lfpipe.config import LiveSource
from lfpipe.errors import UserError
from lfpipe.live.program import RecordedProgram
from lfpipe.sequence import edit
from lfpipe.sequence.folder import MANIFEST, VIEWS, SequenceWriter, open_sequence, remove_empty
from lfpipe.sequence.packets import PACKETS, encoded, scene_packet
from lfpipe.sequence.views import Known, about_grid, open_views
from lfpipe.transport.ring import Stamp
from tests.live import made
from tests.support.hostile_sequences import FRAMES, STEP_NS, made_sequence

LIVE = made.source(1, 2, 48, 64)


def picture(seq: int) -> np.ndarray:
    return np.random.default_rng(seq).integers(0, 256, (48, 128, 3), np.uint8)


@pytest.fixture
def both(tmp_path: Path) -> Path:
    """A sequence of six frames, with one of the scene between each two."""
    recording = made_sequence(tmp_path / "both")
    (recording / VIEWS).mkdir()
    writer = SequenceWriter(recording / VIEWS, "demo", LIVE.frame_px, 30.0, **about_grid(LIVE))
    for seq in range(FRAMES):
        t_ns = 10**9 + seq * STEP_NS + STEP_NS // 2
        writer.append(picture(seq).tobytes(), "raw", seq, 0, t_ns, t_ns)
    writer.complete()
    return recording


def test_views_open_with_their_grid_and_old_recordings_without(both: Path, whole: Path) -> None:
    opened = open_views(both)
    assert opened is not None
    views, live = opened
    assert live == attrs.evolve(LIVE, source=str(both / VIEWS), recorded=True)
    assert np.array_equal(views.frame(3), picture(3))
    assert open_views(whole) is None


def test_a_part_has_the_views_of_its_time(both: Path, tmp_path: Path) -> None:
    edit.cut(open_sequence(both), tmp_path / "part", 0.0, 2.4 * STEP_NS / 1e9)
    opened = open_views(tmp_path / "part")
    assert opened is not None and opened[1].cols == 2
    assert len(open_sequence(tmp_path / "part").packets) == 3
    assert [packet.source_seq for packet in opened[0].packets] == [0, 1]


def test_info_and_check_know_the_views(both: Path) -> None:
    said = CliRunner().invoke(cli, ["sequence", "info", "--json", str(both)])
    views = json.loads(said.output)[VIEWS]
    assert views["frames"] == FRAMES and views["cols"] == 2
    said = CliRunner().invoke(cli, ["sequence", "check", str(both)])
    assert f"{FRAMES} frames and {FRAMES} of the scene" in said.output
    data = bytearray((both / VIEWS / PACKETS).read_bytes())
    data[-1] ^= 1
    (both / VIEWS / PACKETS).write_bytes(data)
    with pytest.raises(UserError, match=f"{VIEWS}: frame {FRAMES - 1}: .*changed"):
        CliRunner().invoke(
            cli, ["sequence", "check", str(both)], standalone_mode=False, catch_exceptions=False
        )


def known_of(maps: np.ndarray, positions: object = np.nan) -> Known:
    return Known(0.25, np.broadcast_to(np.asarray(positions, float), (2, 2)), maps)


def drawn_sequence(recording: Path, live: LiveSource, packets: list[bytes]) -> Path:
    """A recording with views that a program drew."""
    (recording / VIEWS).mkdir(parents=True)
    about = about_grid(attrs.evolve(live, drawn=True))
    writer = SequenceWriter(recording / VIEWS, "ring:x", live.frame_px, 30.0, **about)
    for seq, packet in enumerate(packets):
        writer.append(packet, "scene", seq, 0, seq + 1, seq + 1)
    writer.complete()
    return recording


@pytest.mark.parametrize("positions", [np.nan, [[0.0, 0.5], [0.5, 1.5]]])
def test_what_a_program_knew_of_a_frame_comes_back(tmp_path: Path, positions: object) -> None:
    live = made.source(2, 2, 48, 63)
    frame = np.random.default_rng(1).integers(0, 256, (96, 126, 3), np.uint8)
    maps = np.random.default_rng(2).integers(-128, 128, (4, 24, 32), np.int8)
    packet = scene_packet(encoded(frame, "png"), known_of(maps, positions).packed())
    opened = open_views(drawn_sequence(tmp_path / "rec", live, [packet]))
    assert opened is not None and opened[1].drawn
    np.testing.assert_array_equal(opened[0].frame(0), frame)
    known = Known.of(*opened, 0)
    assert known is not None and known.step_px == 0.25
    drawn = 4 if positions is np.nan else 2
    np.testing.assert_array_equal(known.maps, maps[:drawn])
    np.testing.assert_array_equal(known.positions, known_of(maps, positions).positions)
    found = RecordedProgram(opened[1]).found(Stamp(1, 0, 0, 1, 1, 0, 0), [(1, 0), (1, 1)])
    assert found is not None
    views = [(1, 0), (1, 1)] if positions is np.nan else [(0, 0), (0, 1)]
    assert list(found.maps) == views
    np.testing.assert_array_equal(found.maps[views[1]], maps[3 if positions is np.nan else 1])


@given(end=st.binary(max_size=60), keep=st.integers(0, 200))
def test_damaged_disparity_of_a_program_is_refused_or_has_its_size(
    end: bytes, keep: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    picture_packet = encoded(picture(0), "jpeg")
    whole = scene_packet(picture_packet, known_of(np.zeros((2, 24, 32), np.int8)).packed())
    data = whole[: len(whole) - keep] + end
    opened = open_views(drawn_sequence(tmp_path_factory.mktemp("d") / "rec", LIVE, [data]))
    assert opened is not None
    try:
        known = Known.of(*opened, 0)
    except UserError as error:
        assert "frame 0" in error.message and error.remedy
        return
    assert known is not None and known.maps.shape == (2, 24, 32)


GRIDS = st.integers(-1, 4) | st.integers()


@given(grid=st.fixed_dictionaries(dict.fromkeys(("rows", "cols", "tiles_across"), GRIDS)))
def test_any_grid_divides_the_frame_or_is_refused(
    grid: dict[str, int], tmp_path_factory: pytest.TempPathFactory
) -> None:
    recording = tmp_path_factory.mktemp("grid")
    (recording / VIEWS).mkdir()
    writer = SequenceWriter(
        recording / VIEWS, "demo", LIVE.frame_px, 30.0, **{VIEWS: grid | {"depth": False}}
    )
    writer.append(picture(0).tobytes(), "raw", 0, 0, 1, 1)
    writer.complete()
    try:
        opened = open_views(recording)
    except UserError as error:
        assert MANIFEST in error.message and error.remedy
        return
    assert opened is not None
    live = opened[1]
    tiles = (live.width_px * live.tiles_across, live.height_px * live.rows * live.cols)
    assert tiles == (live.frame_px[0], live.frame_px[1] * live.tiles_across)


def test_views_that_are_a_link_out_of_the_recording_are_refused(both: Path, tmp_path: Path) -> None:
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / VIEWS).symlink_to(both / VIEWS)
    with pytest.raises(UserError, match="link"):
        open_views(tmp_path / "linked")


def test_a_recording_without_a_frame_is_removed_with_its_views(both: Path) -> None:
    for folder in (both, both / VIEWS):
        for name in (PACKETS, "frames.jsonl"):
            (folder / name).write_bytes(b"")
        (folder / "truth.csv").unlink(missing_ok=True)
    remove_empty(both)
    assert not both.exists()
