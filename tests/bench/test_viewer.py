"""`lfpipe bench viewer` in its short form: every metric is within its bound."""

from collections.abc import Iterator

import pytest

from lfpipe.bench.results import Results, Table
from lfpipe.bench.simulator.bounds import BOUNDS, beyond
from lfpipe.bench.simulator.scripts import SCRIPTS, Script
from lfpipe.bench.viewer import PHASES, PICTURES, other_tables, script_tables


def check(tables: Iterator[Table]) -> None:
    """What `--check` prints; `tests/mutation_check.py` reads it."""
    lines = beyond(Results("viewer", list(tables)))
    assert not lines, "\n".join(lines)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_no_figure_of_a_script_is_beyond_its_bound(script: Script) -> None:
    assert script.name in BOUNDS
    check(script_tables([script], PICTURES[0]))


def test_no_figure_of_a_scene_a_camera_or_a_screen_is_beyond_its_bound() -> None:
    check(other_tables(PHASES[0]))
