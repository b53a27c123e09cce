"""Typical user data sets are opened correctly, or refused with the right reason."""

import re
from collections.abc import Iterator
from pathlib import Path

import attrs
import pytest

from lfpipe import config
from lfpipe.config import options
from lfpipe.scene import source as scene_source
from lfpipe.scene.analysis import analyse_scene
from tests.scene.people_sets import SETS, verdict

CASES = {
    f"{group}: {case.kind}": case
    for group, cases in SETS.items()
    for case in cases
    if not case.again
}


def typed(remedy: str, path: Path, scene: config.Scene) -> Iterator[tuple[Path, config.Scene]]:
    """The scenes and settings that a remedy names in so many words."""
    for key, value in re.findall(r"--set scene\.(\w+)=([\w./-]+)", remedy):
        if value not in ("ROWSxCOLS", "DIR"):
            yes = value == "true" if bool in options()[f"scene.{key}"].types else value
            yield path, attrs.evolve(scene, **{key: yes})
    for named in re.findall(r"/[^\s;,:`)]+", remedy):
        if Path(named).exists() and Path(named) != path and "scene make" not in remedy:
            yield Path(named), config.Scene()


@pytest.mark.parametrize("name", CASES)
def test_a_set_that_people_have_is_read_as_what_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Or it is refused, and the remedy opens it when it is typed or carried out."""
    monkeypatch.setattr(scene_source, "MAX_FILES", 300)  # enough for each of them but one
    case = CASES[name]
    (tmp_path / "given").mkdir()
    path = case.make(tmp_path / "given")
    word, what = verdict(case, path)
    assert word == "right", what
    remedy = what.partition(" (remedy: ")[2].replace("PATH", str(path))
    assert case.opens or len(remedy) > 1
    cures = list(typed(remedy, path, case.scene))
    if case.cure is not None:
        cures.append(case.cure(path))
    for opened, settings in cures:
        source = analyse_scene(opened, settings).source
        for place in {(0, 0), (source.rows - 1, source.cols - 1)} - source.missing:
            assert source.read(0, *place).size
