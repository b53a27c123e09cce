"""Each refusal of the layouts, and its remedy carried out on the scene that was refused, which opens it."""

from pathlib import Path

import pytest

from lfpipe.errors import UserError
from lfpipe.scene.examination import examine_scene
from tests.scene.messages import REFUSALS


@pytest.mark.parametrize("name", REFUSALS)
def test_the_remedy_opens_the_scene(tmp_path: Path, name: str) -> None:
    row = REFUSALS[name]
    path = row.make(tmp_path)
    with pytest.raises(UserError) as refused:
        examine_scene(path, row.given)
    assert row.text in refused.value.message and refused.value.remedy
    if row.cure is not None:
        source = examine_scene(*row.cure(path)).source
        for row_col in {(0, 0), (source.rows - 1, source.cols - 1)} - source.missing:
            assert source.read(0, *row_col).size
