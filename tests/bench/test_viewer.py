"""`lfpipe bench viewer` in its short form: every metric is within its bound."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

from lfpipe.bench import viewer
from lfpipe.bench.results import Results, Table
from lfpipe.bench.simulator.metrics import BOUNDS, beyond
from lfpipe.bench.simulator.scripts import SCRIPTS, Script
from lfpipe.bench.viewer import MOVING, PICTURES, other_tables, script_tables
from lfpipe.cli import cli


def check(tables: Iterator[Table]) -> None:
    """What `--check` prints."""
    lines = beyond(Results("viewer", list(tables)))
    assert not lines, "\n".join(lines)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_no_figure_of_a_script_is_beyond_its_bound(script: Script) -> None:
    """Of one in four also the pictures, which follow from the viewpoints."""
    check(islice(script_tables([script], PICTURES[0]), 2 if script in SCRIPTS[::4] else 1))
    assert script.name in BOUNDS


def test_no_figure_of_a_scene_a_camera_or_a_screen_is_beyond_its_bound() -> None:
    check(other_tables(phases=1))


@pytest.mark.live
def test_the_command_checks_every_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`lfpipe bench viewer --check` of one script."""
    (script,) = (script for script in SCRIPTS if script.name == MOVING[0])
    monkeypatch.setattr(viewer, "SCRIPTS", [script])
    monkeypatch.setattr(viewer, "other_tables", lambda _: iter(()))
    words = ["bench", "viewer", "--quick", "--check", "--out", str(tmp_path / "out")]
    assert cli.main(words, standalone_mode=False) == 0
    monkeypatch.setitem(BOUNDS[script.name], "error_worst", 0.0)
    assert cli.main(words, standalone_mode=False) == 1
    said = capsys.readouterr()
    assert f"{script.name}: " in said.out + said.err and "at most 0 is right" in said.out + said.err
