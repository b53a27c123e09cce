"""Each remedy of the layouts' messages, carried out on the scene that was refused, opens it."""

from pathlib import Path

import pytest

from lfpipe.scene.examination import examine_scene
from tests.scene.messages import REFUSALS


@pytest.mark.parametrize("name", [name for name, row in REFUSALS.items() if row.cure is not None])
def test_the_remedy_opens_the_scene(tmp_path: Path, name: str) -> None:
    row = REFUSALS[name]
    assert row.cure is not None
    source = examine_scene(*row.cure(row.make(tmp_path))).source
    for row_col in {(0, 0), (source.rows - 1, source.cols - 1)} - source.missing:
        assert source.read(0, *row_col).size
