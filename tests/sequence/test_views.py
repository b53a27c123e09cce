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
from lfpipe.errors import UserError
from lfpipe.sequence import edit
from lfpipe.sequence.folder import MANIFEST, VIEWS, SequenceWriter, open_sequence, remove_empty
from lfpipe.sequence.packets import PACKETS
from lfpipe.sequence.views import about_grid, open_views
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


@given(grid=st.fixed_dictionaries(dict.fromkeys(("rows", "cols", "tiles_across"), st.integers())))
def test_any_grid_divides_the_frame_or_is_refused(
    grid: dict[str, int], tmp_path_factory: pytest.TempPathFactory
) -> None:
    recording = tmp_path_factory.mktemp("grid")
    (recording / VIEWS).mkdir()
    writer = SequenceWriter(recording / VIEWS, "demo", LIVE.frame_px, 30.0, **{VIEWS: grid})
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
