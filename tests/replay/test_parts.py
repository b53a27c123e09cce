"""Truth and the kept pictures, called as plain functions."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.render import replay_writer
from lfpipe.render.replay_writer import ReplayWriter
from lfpipe.sequence.eyes import Truth, read_truth
from lfpipe.sequence.packets import read_index
from lfpipe.transport.ring import Stamp


@given(st.integers(0, 1_000_000_000), st.floats(-50, 50), st.floats(-50, 50))
def test_truth_lies_on_the_line_between_frames(t_ns: int, x_px: float, y_px: float) -> None:
    ends = np.array([[[0.0, 0.0], [10.0, 0.0]], [[x_px, y_px], [10.0 + x_px, y_px]]])
    truth = Truth(np.array([0, 1_000_000_000]), ends, np.array([True, True]))
    at = truth.at(t_ns)
    assert at is not None and np.allclose(at, ends[0] + t_ns / 1e9 * (ends[1] - ends[0]), atol=1e-9)
    assert truth.error_px(np.add(at, [3.0, 4.0]), t_ns) == pytest.approx(5.0)
    assert truth.at(-1) is None and truth.at(1_000_000_001) is None


def test_hidden_eyes_have_no_error() -> None:
    truth = Truth(np.array([0, 10, 20]), np.zeros((3, 2, 2)), np.array([True, True, False]))
    assert truth.at(5) is not None and truth.at(15) is None and truth.at(20) is None


def test_a_wrong_truth_is_named(tmp_path: Path) -> None:
    assert read_truth(tmp_path) is None
    (tmp_path / "truth.csv").write_text("t_ns,left_x_px\n0,1\n")
    with pytest.raises(UserError, match="not a table of true eyes"):
        read_truth(tmp_path)


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
