"""A cell of a sweep by itself."""

from pathlib import Path

import pytest

from lfpipe.sweep.cell import OK, Cell
from lfpipe.sweep.work import Parcel, do_cell
from tests.sweep.conftest import write_wall


def test_a_subject_of_the_benchmark_as_a_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    scene = write_wall(tmp_path / "wall", 0)
    cell = Cell("plan", "", str(scene), (), key="k")
    done, _ = do_cell(cell, Parcel("", "", b""), Parcel(str(scene), "", b""), b"", False)
    assert done.state == OK and done.host == "here", done.reason
