"""What a plan becomes: cells, their keys, and refusals that name the key; what a table of results
quotes.
"""

import shutil
from pathlib import Path

import pytest

from lfpipe.extras.sweep.plan import Cell, read_plan
from lfpipe.extras.sweep.run import content, keyed
from lfpipe.extras.sweep.work import SweepOptions
from tests.extras.sweep.conftest import write_plan
from tests.support.refusal import refusal

FULL = """
sequences = ["CORPUS/recordings/*"]
scenes = ["CORPUS/scenes/s[0-2]", "CORPUS/scenes/nowhere"]
subjects = ["quality", "truth", "table"]
[config]
"render.method" = ["warp", "warp2"]
track.filter = "mean"
[table]
keep = [2, 3]
border = [4]
"""


def test_every_combination_is_a_cell_with_a_key_of_its_own(tmp_path: Path, corpus: Path) -> None:
    plan = read_plan(write_plan(tmp_path, corpus, FULL))
    found = [keyed(cell, "v1", SweepOptions(1.0)) for cell in plan]
    assert len(found) == 2 * 4 * 2 + 2 * 4 + 2 * 4 * 2
    assert all(
        len({getattr(cell, name) for cell in found}) == len(found)
        for name in ("key", "name", "folder")
    )
    assert all("track.filter=mean" in cell.sets for cell in found)
    assert {cell.sequence != "" for cell in found if cell.subject == "truth"} == {True}
    assert not {keyed(cell, "v2", SweepOptions(1.0)).key for cell in plan} & {
        cell.key for cell in found
    }
    # whether they are compared matters
    for options in (
        SweepOptions(1.0, str(tmp_path)),
        SweepOptions(1.0, str(tmp_path), update=True),
    ):
        assert {
            keyed(cell, "v1", options).key == key
            for cell, key in zip(plan, (c.key for c in found), strict=True)
            if cell.subject == "quality"
        } == {False}
    folder = Cell(
        subject="replay",
        sequence="/a/../é/%$ walk",
        scene="/x/" + "s" * 300,
        sets=("render.method=warp2", 'screen.x="/"'),
    ).folder
    assert "/" not in folder and len(folder) < 100 and not folder.startswith("."), (
        "the name of a reference"
    )


def test_a_key_follows_contents_not_the_place(tmp_path: Path, corpus: Path) -> None:
    for folder in ("recordings/walk", "scenes/s0"):
        shutil.copytree(corpus / folder, tmp_path / folder, copy_function=shutil.copyfile)
        assert content(str(tmp_path / folder)) == content(str(corpus / folder))
    hashes = {content(str(corpus / "scenes" / name)) for name in ("s0", "s1", "s2", "nowhere")}
    assert len(hashes) == 4


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("subjects = [", "not valid TOML"),
        ('subjects = ["qualty"]', "did you mean 'quality'"),
        ("subjects = []", "the list is empty"),
        ('subject = ["quality"]', "did you mean 'subjects'"),
        ('subjects = ["quality"]', "needs scenes"),
        ('subjects = "quality"', "a list of strings"),
        ('subjects = ["synthesis"]\n[config]\n"render.methd" = ["warp"]', "render.method"),
        ('subjects = ["synthesis"]\n[config]\n"render.method" = []', "empty"),
        ('subjects = ["synthesis"]\n[table]\nkeep = [4]', "table.keep: 4"),
        ('subjects = ["synthesis"]\nconfig = 3', "a table"),
    ],
)
def test_mistakes_are_named_before_anything_runs(tmp_path: Path, text: str, said: str) -> None:
    refused = str(refusal(read_plan, write_plan(tmp_path, tmp_path, text)))
    assert said in refused and ("plan.toml" in refused or "configuration" in refused)
