"""Sets as people have them open as what they are, or are refused for the right reason."""

import re
from collections.abc import Iterator
from pathlib import Path

import attrs
import pytest

from lfpipe import config
from lfpipe.config import options
from lfpipe.errors import UserError
from lfpipe.scene.examination import examine_scene
from tests.scene.people_sets import SETS, verdict
from tests.scene.test_refusals import REFUSALS

CASES = {f"{group}: {case.kind}": case for group, cases in SETS.items() for case in cases}


@pytest.mark.parametrize("name", CASES)
def test_a_set_that_people_have_is_read_as_what_it_is(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    word, what = verdict(case, case.make(tmp_path))
    assert word == "right", what


def typed(remedy: str, path: Path, scene: config.Scene) -> Iterator[tuple[Path, config.Scene]]:
    """The scenes and settings that a remedy names in so many words."""
    for key, value in re.findall(r"--set scene\.(\w+)=([\w./-]+)", remedy):
        if value not in ("ROWSxCOLS", "DIR"):
            yes = value == "true" if bool in options()[f"scene.{key}"].types else value
            yield path, attrs.evolve(scene, **{key: yes})
    for named in re.findall(r"/[^\s;,:`]+", remedy):
        if Path(named).exists() and Path(named) != path and "scene make" not in remedy:
            yield Path(named), config.Scene()


REFUSED = {
    **{name: (case.make, case.scene) for name, case in CASES.items() if not case.opens},
    **{name: (row.make, row.given) for name, row in REFUSALS.items()},
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_remedy_opens_the_scene_when_it_is_typed(tmp_path: Path, name: str) -> None:
    make, scene = REFUSED[name]
    path = make(tmp_path)
    with pytest.raises(UserError) as refused:
        examine_scene(path, scene)
    assert refused.value.remedy
    for opened, settings in typed(refused.value.remedy, path, scene):
        assert examine_scene(opened, settings).source.rows >= 1
